"""Evidence of flight code by other tools: compilers, emulators, gcov, cppcheck, pmccabe, frama-c."""

import re
import subprocess

from tests.polaris.flight.library import built, read_code, sources, tool

ADVISORY = {"misra-c2012-2.5", "misra-c2012-8.9"}
"""Rules with a reason in docs/flight-code.md."""

ANYTHING = """#include "PREFIX.h"
extern volatile PREFIX_input anything;
extern volatile int on;
int main(void)
{
    PREFIX_output output;
    MEMORY
    while (on != 0) {
        PREFIX_input input = anything;
        STEP
    }
    return 0;
}
"""


def source_of(folder):
    """Return the path of the code in a folder, beside its self-test."""
    return folder / f"{read_code(folder)[0]}.c"


def assert_self_test_passes(folder, compiler, out, *flags, emulator=()):
    program = built(folder, compiler, sources(folder), out, *flags)
    done = subprocess.run([*emulator, program], capture_output=True, text=True)
    assert done.returncode == 0 and re.fullmatch(r"\d{3,} vectors, all as expected\n", done.stdout)


def assert_every_branch_is_taken(folder):
    """Run the self-test in a folder, which may be written; returns the number of branches."""
    name, gcov = source_of(folder).name, tool("gcov")
    program = built(folder, "gcc", sources(folder), folder / "test", "--coverage", "-O0")
    subprocess.run([program], cwd=folder, check=True, capture_output=True)
    command = [gcov, "-b", f"test-{name.replace('.c', '.gcda')}"]
    done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    ours = done.stdout.split("File ")[1]
    coverage = re.search(r"Taken at least once:100\.00% of (\d\d+)", ours)
    assert f"{name}'" in ours and coverage, ours
    return int(coverage[1])


def assert_no_required_rule_is_broken(folder, advisory=ADVISORY):
    options = "--addon=misra --std=c99 -DFLT_EVAL_METHOD=0 --enable=style,warning,portability --template={id}"
    command = [tool("cppcheck"), "-q", *options.split(), source_of(folder)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0 and set(done.stderr.split()) == advisory, done.stderr


def assert_simple(folder, out, stack):
    """Check paths through each function (McCabe), and bytes of all stacks with one call inside another.

    Returns the number of functions, and of lines without tables.
    """
    source = source_of(folder)
    text = source.read_text()
    built(folder, "gcc", [source.name], out, "-O1", "-fstack-usage", "-c")
    used = [line.split("\t") for line in out.with_suffix(".su").read_text().splitlines()]
    assert all(kind == "static" for *_, kind in used) and sum(int(size) for _, size, _ in used) <= stack
    assert "while" not in text and "goto" not in text
    done = subprocess.run([tool("pmccabe"), source], capture_output=True, text=True, check=True)
    paths = [int(line.split()[0]) for line in done.stdout.splitlines()]
    assert max(paths) <= 15
    lines = re.sub(r"static const \w+ \w+\[.*?\};", "", text, flags=re.DOTALL).count("\n")
    return len(paths), lines + source.with_suffix(".h").read_text().count("\n")


def assert_no_run_time_error(folder, at, *kinds):
    """Analyse any sequence of inputs, finite or not, to steps of some kinds (`settling`, `online`).

    Returns the summary of the analysis.
    """
    steps = {"memory": "PREFIX", "online": "PREFIX_online"}
    starts = "\n".join(f"PREFIX_{kind} {kind};\n{steps[kind]}_start(&{kind});" for kind in kinds)
    calls = "\n".join(f"{steps[kind]}_step(&{kind}, &input, &output);" for kind in kinds)
    source = source_of(folder)
    text = ANYTHING.replace("MEMORY", starts).replace("STEP", calls).replace("PREFIX", source.stem)
    (at / "main.c").write_text(text)
    options = "-eva -eva-precision 0 -eva-auto-loop-unroll 20 -warn-special-float none"
    include = f"-cpp-extra-args=-I{folder} -DFLT_EVAL_METHOD=0"
    command = [tool("frama-c"), *options.split(), include, at / "main.c", source]
    done = subprocess.run(command, capture_output=True, text=True)
    summary = done.stdout[done.stdout.index("ANALYSIS SUMMARY") :]
    assert "0 alarms generated" in summary and "No errors or warnings" in summary, summary
    return summary
