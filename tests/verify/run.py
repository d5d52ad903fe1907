"""The behaviour, proved on the function that ships.

Proves: SPIN calls sim/behaviour.c with every sequence of inputs (behaviour.pml says which; TELEDIMOS_FULL=1: more) and
finds no reaction that breaks a property of properties.h, and no sequence that breaks a temporal claim of behaviour.pml.
The search is exhaustive: states are stored whole, its depth is not cut off.
Each property can fail: mutants/*.sed are small mistakes in the code, each caught by the property that its name gives.
The C test of the behaviour takes every branch of the code, by gcov.
Blind to: tasks of more than two identities, and options beyond the eight of verify_begin; what the caller makes of the
outputs.

  run.py SOURCE WORK_FOLDER
"""

import concurrent.futures
import os
import re
import shutil
import subprocess
import sys

SOURCE, WORK = (os.path.abspath(a) for a in sys.argv[1:3])
HERE = os.path.join(SOURCE, "tests/verify")
FULL = os.environ.get("TELEDIMOS_FULL", "0") == "1"
CLAIMS = ["pause", "failed", "progress"]
failures = 0


def check(condition, text):
    global failures
    print(("ok      " if condition else "FAILED  ") + text, flush=True)
    failures += not condition


def call(command, folder, **environment):
    done = subprocess.run(command, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          env={**os.environ, **environment}, timeout=1800 if FULL else 300)
    return done.returncode, done.stdout


def must(command, folder, **environment):
    code, text = call(command, folder, **environment)
    if code != 0:
        sys.exit(f"FAILED  {' '.join(command)}\n{text}")
    return text


def compile_c(source, target, folder, *flags):
    must(["gcc", "-std=gnu17", "-O2", "-I", SOURCE, *flags, "-c", source, "-o", target], folder)


def verifier(name, spin_flags, c_flags):
    """NAME/pan.o for one form of the model: the code it judges is linked later."""
    folder = os.path.join(WORK, name)
    os.makedirs(folder)
    must(["spin", *spin_flags, "-a", os.path.join(HERE, "behaviour.pml")], folder)
    # T_REVERSE: the last events and levels first, which lead deeper; mistakes are found sooner.
    compile_c("pan.c", "pan.o", folder, "-w", "-O1", "-DNOREDUCE", "-DT_REVERSE", *c_flags)


def search(folder, behaviour, name, claim=None, **environment):
    """Links behaviour.o to a verifier and runs it. Returns its output, errors, whether it was cut off, figures."""
    os.makedirs(folder, exist_ok=True)
    pan, properties = os.path.join(WORK, name, "pan.o"), os.path.join(WORK, "properties.o")
    must(["gcc", pan, behaviour, properties, "-o", "pan"], folder)
    flags = ["-m50000", "-w18"] + (["-a", "-N", claim] if claim else [])
    code, text = call(["./pan", *flags], folder, **environment)
    figures = {key: int(value) for value, key in re.findall(r"^ *(\d+) (states, stored|transitions)", text, re.M)}
    errors = re.search(r"errors: (\d+)", text)
    if code != 0 or not errors:
        sys.exit(f"FAILED  pan in {folder}\n{text}")
    cut = "max search depth too small" in text or "Search not completed" in text
    return text, int(errors.group(1)), cut, figures


def prove(claim):
    """Lines for the properties (claim None), or for one temporal claim, on the code as it is."""
    folder = os.path.join(WORK, f"proof_{claim}" if claim else "proof")
    name = "ltl" if claim else "full" if FULL else "reactions"
    text, errors, cut, figures = search(folder, os.path.join(WORK, "behaviour.o"), name, claim)
    if errors:
        replay = ["./pan", "-r"] + (["-N", claim] if claim else [])
        print(call(replay, folder, VERIFY_PRINT="1")[1])
    what = f"temporal claim '{claim}' holds in every sequence" if claim else "every property holds in every reaction"
    return (errors == 0 and not cut, f"{what}: {figures['states, stored']} states, {figures['transitions']} "
            "transitions, all of them searched")


def mutant(name):
    """A line for one mutant: what was broken, and whether its property saw it."""
    folder = os.path.join(WORK, "mutant_" + name)
    os.makedirs(folder)
    script = os.path.join(HERE, "mutants", name + ".sed")
    code = must(["sed", "-E", "-f", script, os.path.join(SOURCE, "sim/behaviour.c")], folder)
    with open(os.path.join(SOURCE, "sim/behaviour.c")) as f:
        if f.read() == code:
            return False, f"mutant {name} does not apply"
    with open(os.path.join(folder, "behaviour.c"), "w") as f:
        f.write(code)
    compile_c("behaviour.c", "behaviour.o", folder, "-w", "-O1")
    with open(script) as f:
        sentence = f.readline().lstrip("# ").strip()
    behaviour = os.path.join(folder, "behaviour.o")
    if name.startswith("ltl-"):
        claim = name.split("-")[1]
        caught = search(folder, behaviour, "ltl", claim)[1] > 0
        return caught, f"claim {claim} catches: {sentence}"
    number = int(name[:2])
    text, errors, _, _ = search(folder, behaviour, "reactions", PROPERTY=str(number))
    return errors > 0 and f"broken: {number} " in text, f"property {number:2} catches: {sentence}"


def mutant_names(properties):
    names = sorted(f[:-4] for f in os.listdir(os.path.join(HERE, "mutants")))
    for start in [f"{number:02}-" for number in range(1, properties + 1)] + [f"ltl-{claim}-" for claim in CLAIMS]:
        if not any(name.startswith(start) for name in names):
            check(False, f"there is a mutant {start}*")
    return names


def coverage():
    """A line on tests/sim/test_behaviour.c: what of the code it runs, by gcov."""
    folder = os.path.join(WORK, "coverage")
    os.makedirs(folder)
    compile_c(os.path.join(SOURCE, "sim/behaviour.c"), "behaviour.o", folder, "-O0", "--coverage")
    compile_c(os.path.join(SOURCE, "tests/sim/test_behaviour.c"), "test.o", folder)
    compile_c(os.path.join(SOURCE, "core/random.c"), "random.o", folder)
    must(["gcc", "--coverage", "behaviour.o", "test.o", "random.o", "../properties.o", "-lcmocka", "-lm", "-o", "test"],
         folder)
    must(["./test"], folder, TELEDIMOS_FULL="0")
    text = must(["gcov", "-b", "behaviour.o"], folder)
    text = text[text.index("sim/behaviour.c'"):]
    shares = [re.search(words + r":([\d.]+)% of (\d+)", text)
              for words in ("Lines executed", "Branches executed", "Taken at least once")]
    return (all(s and s.group(1) == "100.00" for s in shares),
            "the C test runs every line and takes every branch: " +
            ", ".join(f"{s.group(1)} % of {s.group(2)}" for s in shares if s))


def main():
    if not shutil.which("spin"):
        print("skipped: spin is not installed (Debian package spin)")
        return 77
    shutil.rmtree(WORK, ignore_errors=True)
    os.makedirs(WORK)
    with open(os.path.join(HERE, "properties.h")) as f:
        properties = re.findall(r"^    X\((\w+),", f.read(), re.M)
    print(f"{len(properties)} properties of a reaction, {len(CLAIMS)} temporal claims", flush=True)
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        parts = [pool.submit(verifier, "reactions", [], ["-DSAFETY"]),
                 pool.submit(verifier, "ltl", ["-DLTL"], []),
                 pool.submit(compile_c, os.path.join(HERE, "properties.c"), "properties.o", WORK),
                 pool.submit(compile_c, os.path.join(SOURCE, "sim/behaviour.c"), "behaviour.o", WORK)]
        if FULL:
            parts.append(pool.submit(verifier, "full", ["-DFULL"], ["-DSAFETY"]))
        for part in parts:
            part.result()
        lines = [pool.submit(prove, claim) for claim in [None, *CLAIMS]]
        lines += [pool.submit(mutant, name) for name in mutant_names(len(properties))]
        lines += [pool.submit(coverage)]
        for line in lines:
            check(*line.result())
    return 1 if failures else 0


sys.exit(main())
