"""A novice presses a wall; the run is held against an expert's.

Both hands hold the same simulated device (Touch), with the same seed. The two runs are aligned by place, so that pace
is no error; what counts is how far the tool strays, how hard it presses, how deep it goes, and how smoothly it moves.
Expected: the novice strays by 3.6 mm where the expert went straight, presses with 1.44 N against 1.02, and passes the
limit of force once, 0.6 s after the start. Hands differ by priors (`tissue/materials`), so this shows the method, not
people. Run: python examples/13_assess_a_trainee.py [--out FOLDER]
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import tissue
from tissue.evaluation.assessment import assess, assessment_lines
from tissue.evaluation.assessment_files import write_assessment
from tissue.simulation.run_folder import SavedRun


def main(out: Path | None = None) -> None:
    with TemporaryDirectory() as folder:
        runs = {}
        for hand in ("novice", "expert"):
            scene = tissue.load_scene("wall", {"device": "touch", "hand": hand, "seed": 3})
            tissue.simulate(scene, out=Path(folder) / hand).save(Path(folder) / hand)
            runs[hand] = SavedRun(Path(folder) / hand)
        found = assess(runs["novice"], runs["expert"])
    for line in assessment_lines(found):
        print(line)
    figures = found.figures
    assert abs(figures["deviation_mm"]["worst"] - 3.56) < 0.1
    assert abs(figures["peak_force_N"]["trainee"] - 1.44) < 0.03
    assert abs(figures["peak_force_N"]["reference"] - 1.02) < 0.03
    forces = [each for each in found.breaches if each.what == "force"]
    assert len(forces) == 1 and abs(forces[0].worst_at_s - 0.60) < 0.02
    if out is not None:
        print("files in", out, [path.name for path in write_assessment(found, out, overwrite=True)])


if __name__ == "__main__":
    main(Path(sys.argv[2]) if sys.argv[1:2] == ["--out"] else None)
