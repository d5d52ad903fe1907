"""Proves: every example of every command's help runs as typed.

In their order, in a folder that holds nothing but the datasets. Reference: status 0 and what -o names. Blind to: what the
products hold (each command's own test)."""

import os
import re
import shutil
import subprocess
import tempfile

from common import COMMANDS, ENVIRONMENT, FULL, SOURCE, check, finish, run, shortened

JOBS = ("calibrate", "rectify")  # their products hold a result
# Minutes each, and run by tests of their own: here with TELEDIMOS_FULL=1.
LONG = ("zx200/dig.yaml", "zx200/trench", "zx200/servo.yaml")


def test_examples():
    with tempfile.TemporaryDirectory() as folder:
        os.symlink(os.path.join(SOURCE, "datasets"), os.path.join(folder, "datasets"))
        for name in COMMANDS:
            examples = re.findall(r"^  (teledimos .*)$", run(name, "--help")[1].split("Examples:")[1].split("\n\n")[0], re.M)
            check(len(examples) >= 2, f"{name} --help has {len(examples)} examples")
            for example in examples:
                if not FULL and any(scenario in example for scenario in LONG):
                    continue
                done = subprocess.run(["bash", "-c", example], cwd=folder, env={**os.environ, **ENVIRONMENT},
                                      capture_output=True, encoding="utf-8", timeout=1800)
                out = re.search(r"-o (\S+)", example)
                made = os.path.join(folder, out[1]) if out else folder
                whole = not os.path.isdir(made) or name not in JOBS or os.path.exists(os.path.join(made, "result.yaml"))
                # A machine as busy as one that tests misses deadlines, which ends a live session, and its replay, as it should.
                late = "live" in example and done.returncode == 3 and "deadline was missed" in done.stdout
                check((done.returncode == 0 or late) and os.path.exists(made) and whole,
                      f"{example} ended with {done.returncode} {shortened(done.stderr)}")
            for out in os.listdir(folder):
                if out != "datasets":
                    path = os.path.join(folder, out)
                    (shutil.rmtree if os.path.isdir(path) else os.remove)(path)


test_examples()
finish()
