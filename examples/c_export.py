"""A controller out again: as C for a flight computer, compared with the flight to the last bit."""

# %% Write it: C99, its numbers, a flight as test vectors; where there is a C compiler it is compiled and compared
from pathlib import Path

from cosim import Scenario, export_controller
from cosim.files import new_folder

doublet = Scenario.load("roll-doublet").replace(duration_s=1.4, expect=[])
folder = new_folder(Path("runs"), "c-export")
done = export_controller(doublet, folder, name="ours", licence="MIT", fmus=False)  # True: FMUs of FMI 2 and 3 beside it
print(f"{folder}: {', '.join(done.files)}")
if done.same is None:
    print("no C compiler here: nothing was compared")
else:
    print(f"{done.to_dict()['steps']} steps of the flight: {'the same bits' if done.same else 'other bits'}")

# %% This is what a flight computer calls, once a control step
header = (folder / "ours.h").read_text()
print(*[line for line in header.splitlines() if line.startswith("void ours_")], sep="\n")
print(f"next: cd {folder}; cc -std=c99 -O2 -ffp-contract=off -o test test_ours.c ours.c ours_*.c -lm && ./test")
