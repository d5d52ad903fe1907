"""What two hundred clients cost teledimos panel, of whom twenty read nothing.

They are those of tests/watchers.c, all channels, for a minute (TELEDIMOS_FULL: ten), in a program of its own that costs little,
so that it is the panel that is measured. Without them (but for the one who observes) the same panel runs for a third of that, half
before and half after. The session's thread has a real-time priority where that is permitted, as its manual has it; the server's
never has.

With a free processor: no more deadlines are missed than without clients, or than a bare clock misses at the same time, within what
two counts differ by luck. The bare clock is a process of the same priority that does nothing but wait for its next period: what it
misses the machine itself misses, for a virtual one stands still now and then when its host is busy. Those who read get all periods'
transforms, and no silence is longer than half a second and what the bare clock stood still. With none free, the machine is what is
measured: then one tick in twenty more is let pass. Always: nobody waits for those who do not read, who are put out, and nobody else
is; the memory that the panel holds after the first third is that of the first third.

Reference: the panel's own count of deadlines (sim/clock, tested there), the kernel's of its memory. Bounds are stated where they
stand. Blind to: what a client further away than this machine sees."""

import json
import math
import os
import subprocess
import tempfile
import threading
import time

import numpy

from common import FULL, PROGRAM, SANITIZED, check, finish
from test_panel import Panel

TESTS = os.environ["TELEDIMOS_TESTS"]
SLOW = SANITIZED or "tsan" in PROGRAM
CLIENTS, SILENT, PERIOD = 200, 20, 0.05
SECONDS = 24 if SLOW else 600 if FULL else 60
ALONE = 6 if SLOW else SECONDS / 3
TOLERANCE = 0.02  # s, the scenario's
MEMORY_KIB = 1024
PUT_OUT = ("it reads nothing", "it answers no ping", "its answers pile up")


def first_in_time():
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))


def urgent():
    """What gives the panel a real-time priority; None: it may not have one."""
    try:
        subprocess.run(["true"], preexec_fn=first_in_time, check=True)
        return first_in_time
    except subprocess.SubprocessError:
        return None


BARE_CLOCK = """
import gc, sys, time
gc.disable()
period, tolerance = float(sys.argv[1]), float(sys.argv[2])
due = time.monotonic()
while True:
    due += period
    time.sleep(max(0, due - time.monotonic()))
    now = time.monotonic()
    if now - due > tolerance:
        print(now, now - due, flush=True)
"""


class BareClock:
    """When it missed a period, by CLOCK_MONOTONIC, and by how much: pairs."""

    def __init__(self, before):
        self.missed, self.process = [], subprocess.Popen(["/usr/bin/python3", "-c", BARE_CLOCK, str(PERIOD), str(TOLERANCE)],
                                                         stdout=subprocess.PIPE, text=True, preexec_fn=before)
        self.reader = threading.Thread(target=lambda: self.missed.extend(tuple(map(float, line.split())) for line in self.process.stdout))
        self.reader.start()

    def half_seconds(self, begun, ended):
        """In how many it missed any."""
        return len({int(2 * (at - begun)) for at, _ in self.missed if begun <= at < ended})

    def end(self):
        """How long it stood still at most."""
        self.process.kill()
        self.reader.join()
        self.process.wait()
        return max((late for _, late in self.missed), default=0.0)


def idle_s():
    """Of all processors, since the machine began."""
    with open("/proc/stat") as file:
        ticks = [int(word) for word in file.readline().split()[1:]]
    return (ticks[3] + ticks[4]) / os.sysconf("SC_CLK_TCK")


def counted(observer):
    observer.watch(0.6)  # they are told each half second
    d = observer.newest("/diagnostics")
    return d["misses"], d["ticks"]


def during(observer, wait, clock):
    """While it waits: deadlines missed, half seconds in which any was, ticks, half seconds in which the bare clock missed one."""
    before = counted(observer)
    begun = time.monotonic()
    observer.kept["/diagnostics"] = []
    wait()
    after = counted(observer)
    told = [before[0]] + [json.loads(text)["misses"] for _, text in observer.kept["/diagnostics"]]
    return numpy.array([after[0] - before[0], sum(b > a for a, b in zip(told, told[1:])), after[1] - before[1],
                        clock.half_seconds(begun, time.monotonic())])


def watched(panel, observer, clock):
    """The watchers' report, what happened during it, processors that were free."""
    command = [os.path.join(TESTS, "watch_panel"), panel.port, CLIENTS, SILENT, SECONDS, PERIOD, panel.process.pid]
    begun = idle_s()
    with subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, text=True) as watchers:
        happened = during(observer, lambda: observer.until(lambda: watchers.poll() is not None, SECONDS + 60), clock)
        check(watchers.poll() == 0, "the watchers come to their end")
        if watchers.poll() != 0:
            watchers.kill()
            finish()
        return json.loads(watchers.stdout.read()), happened, (idle_s() - begun) / (happened[2] * PERIOD)


def judge_deadlines(within, alone, free):
    """Half seconds with a miss are counted, not misses, where a processor is free: a machine that stands still for 0.3 s, as
    virtual ones do, misses six deadlines in a row; what clients cost comes all the time."""
    ratio = within[2] / alone[2]
    if not free:
        expected = alone[0] * ratio
        bound = expected + 3 * math.sqrt(expected + 1) + 0.05 * within[2]
        check(within[0] <= bound, f"deadlines missed, of a busy machine: {within[0]} of {within[2]}, bound {bound:.1f}")
        return
    expected = max(alone[1] * ratio, within[3])
    # The variance of a count is its mean. And two: a count of none may as well be of a mean of one, and one standstill may lie
    # across two half seconds.
    bound = expected + 3 * math.sqrt(expected + expected * ratio) + 2
    check(within[1] <= bound, f"half seconds with a deadline missed: {within[1]} of {within[2] // 10}, bound {bound:.1f}")


def judge_readers(told, free, stood):
    check(told["readers"] == CLIENTS - SILENT and told["closed"] == 0, f"all who read are still there: {told['closed']} are not")
    check(told["silence_s"][2] < (0.5 + stood if free else 2), f"nobody waits for those who do not read: {told['silence_s'][2]:.3f} s")
    # A state that is no longer new is skipped by design: of a server that has a processor, none.
    check(not free or told["tf_share"][0] >= 0.98, f"and those who read have what happened: {told['tf_share'][0]:.3f} at least")
    states = [told["messages"][topic] for topic in ("/tf", "/joints", "/joints/desired", "/tool", "/session")]
    check(min(states) > 0.95 * max(states), f"of all channels: {told['messages']}")


def judge_silent(panel, told):
    out = [line for line in panel.audit() if line["what"] == "disconnect" and line["why"].startswith(PUT_OUT)]
    # Those who joined last may leave before their time is up.
    least, most = told["silent_joins"] - SILENT, told["silent_joins"]
    check(least >= SILENT and least <= len(out) <= most, f"{len(out)} who read nothing were put out, of {most}")


def main():
    priority = urgent()
    with tempfile.TemporaryDirectory() as folder, Panel(folder, before=priority) as panel:
        observer = panel.client()
        observer.subscribe("/diagnostics", "/session")
        observer.until(lambda: observer.phase() == "ready")
        clock = BareClock(priority)
        before = during(observer, lambda: observer.watch(ALONE / 2), clock)
        told, within, free_processors = watched(panel, observer, clock)
        alone = before + during(observer, lambda: observer.watch(ALONE / 2), clock)
        stood = clock.end()
        memory, free = told["memory_kib"], not SLOW and free_processors >= 0.5
        print(f"{told['readers']} of {CLIENTS} clients read {told['messages_1_s']:.0f} messages ({told['mb_1_s']:.1f} MB) a second for "
              f"{told['seconds']:.0f} s, {'with' if priority else 'without'} a real-time priority, {free_processors:.2f} processors free:\n"
              f"  missed {within[0]} of {within[2]} deadlines in {within[1]} half seconds, without clients {alone[0]} of {alone[2]} in "
              f"{alone[1]}; a bare clock in {within[3]} and {alone[3]}, at worst {1e3 * stood:.0f} ms late\n"
              f"  {told['tf_share'][0]:.3f} to {told['tf_share'][2]:.3f} of the periods' transforms; longest silence "
              f"{1e3 * told['silence_s'][2]:.0f} ms (median of clients {1e3 * told['silence_s'][1]:.0f})\n"
              f"  of a processor: the panel {told['panel_cpu']:.3f}, its clients {told['own_cpu']:.3f}\n"
              f"  memory {memory[0]} KiB at first, then at most {memory[1]}, then at most {memory[2]}", flush=True)
        judge_deadlines(within, alone, free)
        judge_readers(told, free, stood)
        # The allocator's pieces, and the recording's index; a sanitizer keeps what was freed.
        check(SLOW or memory[2] <= memory[1] + MEMORY_KIB, f"memory stays: {memory} KiB")
        judge_silent(panel, told)
        code, text, errors = panel.end()
        check(code == 0 and "put out" in text, f"it ends: {code} {errors.strip()}")
    finish()


main()
