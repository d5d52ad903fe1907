"""Proves: every example of every command's help runs as typed.

In their order, in a folder that holds nothing but the datasets. Reference: status 0 and what -o names. Those that serve must say so;
then they are interrupted (SIGINT), in place of the operator's own end, and end with status 0, too. Blind to: what the products hold
(each command's own test); mpirun (test_reconstruct_runs.py); ports that another program uses, whose examples are left out."""

import os
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import time

from common import COMMANDS, ENVIRONMENT, FULL, SOURCE, check, finish, run, shortened, skip

JOBS = ("calibrate", "rectify")  # their products hold a result
# Those that serve until they are told to end, and what they say then.
SERVING = {"machine": r"listening on port \d+", "panel": r"panel: ws://\S+"}
# Minutes each, and run by tests of their own: here with TELEDIMOS_FULL=1. A machine's first example to serve is run all the same.
LONG = ("zx200/dig.yaml", "zx200/trench", "zx200/servo.yaml")
ENVIRON = {**os.environ, **ENVIRONMENT}


def examples_of(name):
    block = run(name, "--help")[1].split("Examples:")[1].split("\n\n")[0]
    return [line for line in re.findall(r"^  (\S.*)$", block, re.M) if not line.startswith("mpirun")]


def run_example(folder, name, example):
    done = subprocess.run(["bash", "-c", example], cwd=folder, env=ENVIRON, capture_output=True, encoding="utf-8", timeout=1800)
    out = None if "Benches" in example else re.search(r"-o (\S+)", example)  # to ask what there is leaves nothing
    made = os.path.join(folder, out[1]) if out else folder
    whole = not os.path.isdir(made) or name not in JOBS or os.path.exists(os.path.join(made, "result.yaml"))
    # A machine as busy as one that tests misses deadlines, which ends a live session, and its replay, as it should.
    late = "live" in example and done.returncode == 3 and "deadline was missed" in done.stdout
    if done.returncode == 1 and "machine run" in example and "the other end closed the connection" in done.stderr:
        skip(f"{example}: busy for longer than three heartbeats, it was lost to the machine, which stopped as it should")
        return
    check((done.returncode == 0 or late) and os.path.exists(made) and whole,
          f"{example} ended with {done.returncode} {shortened(done.stderr)}")


class Server:
    """An example that serves, from where it says so to where it is interrupted."""

    def __init__(self, folder, name, example):
        self.example = example
        self.log = tempfile.NamedTemporaryFile("w+", encoding="utf-8")
        self.process = subprocess.Popen(["bash", "-c", "exec " + example], cwd=folder, env=ENVIRON, stdout=self.log, stderr=self.log)
        until = time.monotonic() + 300
        while not re.search(SERVING[name], self.said()) and self.process.poll() is None and time.monotonic() < until:
            time.sleep(0.05)
        check(re.search(SERVING[name], self.said()) is not None, f"{example} serves: {shortened(self.said())}")

    def said(self):
        with open(self.log.name, encoding="utf-8") as file:
            return file.read()

    def end(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            status = self.process.wait(60)
        except subprocess.TimeoutExpired:
            self.process.kill()
            status = None
        check(status == 0, f"{self.example}, interrupted, ended with {status} {shortened(self.said())}")


def is_free(port):
    with socket.socket() as s:
        return s.connect_ex(("127.0.0.1", port)) != 0


def port_of(example):
    """Where it listens; 0: anywhere that is free."""
    found = re.search(r"--listen \S+:(\d+)|--port (\d+)", example)
    return int(found[1] or found[2]) if found else 8765


def serve_examples(folder, examples):
    """Those that end by themselves are run; the others are served, those with & until the last has ended. A person's `sleep` gives
    them time; here it is waited for."""
    behind = []
    for example in examples:
        if not re.match(r"teledimos (panel|machine datasets)", example):
            run_example(folder, "", example)
        elif port_of(example) and not is_free(port_of(example)):
            skip(f"{example}: its port is in use")
            break
        else:
            server = Server(folder, example.split()[1], re.sub(r" & sleep \d+$", "", example))
            if "&" in example:
                behind.append(server)
            else:
                server.end()
    for server in behind:
        server.end()


def is_short(example):
    """A machine is served all the same: this is all that shows its first example to be right."""
    return not any(scenario in example for scenario in LONG) or (example.startswith("teledimos machine datasets") and ":7420" in example)


def test_examples():
    with tempfile.TemporaryDirectory() as folder:
        os.symlink(os.path.join(SOURCE, "datasets"), os.path.join(folder, "datasets"))
        for name in (*COMMANDS, "workbench", *SERVING):
            examples = examples_of(name)
            check(len(examples) >= 2, f"{name} --help has {len(examples)} examples")
            examples = [example for example in examples if FULL or is_short(example)]
            if name in SERVING:
                serve_examples(folder, examples)
                examples = []
            for example in examples:
                run_example(folder, name, example)
            for out in os.listdir(folder):
                if out != "datasets":
                    path = os.path.join(folder, out)
                    (shutil.rmtree if os.path.isdir(path) else os.remove)(path)


test_examples()
finish()
