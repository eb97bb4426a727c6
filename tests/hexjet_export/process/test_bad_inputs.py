"""An exported controller whose input is not finite: it keeps its output, and goes on as if the step had not been."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from exported_controllers import CASES, CC, LOOPS, STRICT, driven, made, written

from cosim.simulation.build import build
from hexjet_export.controller import measure
from hexjet_export.controller.form import make_form

pytestmark = pytest.mark.skipif(CC is None, reason="no C compiler")
PROGRAM = r"""
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "ours.h"

static ours_State state;
static int wrong;

static ours_Input good_input(int k)
{
    ours_Input in = {0};
    for (int i = 0; i < 3; i++) {
        in.rate[i] = (ours_Real)(0.02 * sin(0.03 * (double)((i + 1) * k)));
        in.attitude_setpoint[i] = (ours_Real)(0.05 * ((k / 40) % 2));
    }
    in.attitude[0] = (ours_Real)1.0;
    in.altitude_setpoint = (ours_Real)3.0;
    in.altitude = (ours_Real)(3.0 + 0.1 * sin(0.01 * (double)k));
    return in;
}

static void start(void)
{
START
}

static ours_Output step(const ours_Input *in)
{
    ours_Output output;
    memset(&output, 0, sizeof(output));
    ours_step(&ours_parameters, &state, in, &output);
    return output;
}

static void tell(const char *what, const ours_Output *o, int asked, int printed)
{
    for (int i = 0; i < ANSWERS; i++) {
        if (!(isfinite(o->ANSWER[i]) != 0)) {
            wrong++;
        }
        if (printed) {
            printf("%a ", (double)o->ANSWER[i]);
        }
    }
    if ((int)o->held != asked) {
        printf("%s: held is %d\n", what, (int)o->held);
        wrong++;
    }
}

int main(int argc, char **argv)
{
    const double bad[3] = {NAN, INFINITY, -INFINITY};
    const int spoiled = argc > 1;
    (void)argv;
    start();
    for (int k = 0; k < 200; k++) {
        ours_Input in = good_input(k);
        ours_Output output = step(&in);
        tell("good", &output, 0, 1);
        for (int which = 0; spoiled && (which < FIELDS); which++) {
            ours_Output again;
            ours_Real *const fields[FIELDS] = {PLACES};
            in = good_input(k);
            *fields[which] = (ours_Real)bad[(k + which) % 3];
            again = step(&in);
            tell("bad", &again, 1, 0);
            for (int i = 0; i < ANSWERS; i++) {
                wrong += again.ANSWER[i] < output.ANSWER[i] || again.ANSWER[i] > output.ANSWER[i];
            }
        }
        if (spoiled) { /* what a step does not look at may be anything */
            in = good_input(k);
            in.rate_setpoint[0] = (ours_Real)NAN;
            in.collective_setpoint = (ours_Real)NAN;
            const ours_State before = state;
            output = step(&in);
            tell("unused", &output, 0, 0);
            state = before;
        }
    }
    puts("");
    start();
    for (int k = 0; k < 20; k++) { /* engines go idle all the same */
        ours_Input in = good_input(k);
        in.engines = (k == 10) ? OURS_IDLE : OURS_FLY;
        in.attitude[1] = (spoiled && (k == 10)) ? (ours_Real)NAN : (ours_Real)0.0;
        ours_Output output = step(&in);
        tell("idle", &output, spoiled && (k == 10), 1);
    }
    return wrong != 0;
}
"""
FIELDS = ("rate[0]", "rate[2]", "attitude[0]", "attitude[3]", "attitude_setpoint[1]", "altitude", "fuel_burnt")


def answers(folder: Path, loops: bool, *flags: str) -> None:
    """Compile the program, fly with and without spoiled steps, and compare all that the good steps answered."""
    fields = [*FIELDS, "velocity_down", "altitude_setpoint", *(["unallocated[3]"] if loops else [])]
    start = (
        "    ours_reset(&ours_parameters, &state, (ours_Real)0.0);"
        if loops
        else "    ours_Real throttle[OURS_JETS];\n    ours_reset(&ours_parameters, &state, false, (ours_Real)0.0, throttle);"
    )
    source = PROGRAM
    words = {"START": start, "PLACES": ", ".join(f"&in.{field}" for field in fields), "FIELDS": str(len(fields))}
    words |= {"ANSWERS": "3" if loops else "OURS_JETS", "ANSWER": "torque" if loops else "throttle"}
    for word, text in words.items():
        source = source.replace(word, text)
    (folder / "spoiled.c").write_text(source)
    program = folder / "spoiled"
    files = [str(folder / name) for name in ("spoiled.c", "ours.c", "ours_parameters.c")]
    command = [str(CC), *measure.CFLAGS, *STRICT, *flags, "-o", str(program), *files, "-lm"]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    good, spoiled = (
        subprocess.run([str(program), *more], capture_output=True, text=True, check=False) for more in ([], ["spoiled"])
    )
    assert (good.returncode, spoiled.returncode) == (0, 0), spoiled.stdout
    assert len(set(good.stdout.split())) > 200
    assert good.stdout == spoiled.stdout


@pytest.mark.parametrize("flags", [(), ("-DOURS_FLOAT",)], ids=["double", "float"])
@pytest.mark.parametrize(
    "case",
    [
        "baseline",
        "state-disturbance",
        "curves, leads and schedule",
        "hinges in chains",
        "nozzles, and no horizontal force",
    ],
)
def test_a_bad_input_leaves_no_trace(case: str, flags: tuple[str, ...], tmp_path: Path) -> None:
    name, changes = CASES[case]
    with build(made(name, changes)) as simulation:
        folder = written(tmp_path, simulation, driven(simulation, 2, 1), make_form(simulation))
    answers(folder, False, *flags)


@pytest.mark.parametrize("case", ["curves, leads and schedule", "accelerations"])
def test_a_bad_input_leaves_no_trace_in_the_loops_alone(case: str, tmp_path: Path) -> None:
    name, changes = LOOPS[case]
    with build(made(name, changes)) as simulation:
        folder = written(tmp_path, simulation, driven(simulation, 2, 1), make_form(simulation, loops=True))
    answers(folder, True)
