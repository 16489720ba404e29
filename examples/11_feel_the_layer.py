"""Can a hand discriminate a liver's capsule from the parenchyma under it, and does it help to know the hand?

Expected: in the tenth of a second before the puncture the needle is held back by 2.1 N, in the one after it by 1.6 N,
and 100 simulated people of each group discriminate the two with an error below 10 %. Scaling the force for each,
after 24 numbers they gave, changes their right answers by less than 3 %: a mapping that rises with the force cannot add
information. It spreads the difference for people whose exponent lies below the reference's and narrows it for the
others. For an observer equal to the reference it changes nothing at all. The tissue itself scatters by more than any of
this; people's exponents and thresholds are priors.
Run: python examples/11_feel_the_layer.py
"""

import numpy as np

import tissue
from tissue.evaluation.calibration.force_discrimination import Stimulus, calibrated_commands, gain_of, share_right
from tissue.evaluation.calibration.simulated_observer import SimulatedObservers, draw_observers
from tissue.perception.population import reference_observer
from tissue.scene.registry import HANDS
from tissue.simulation.trace import Table

PEOPLE = 100
WINDOW_S = 0.1
"""As long as a person averages a force."""


def stimulus(trace: Table, start_s: float) -> Stimulus:
    """The force on the tool in a window of a run."""
    rows = (trace["time_s"] >= start_s) & (trace["time_s"] < start_s + WINDOW_S)
    return Stimulus(float(np.linalg.norm(trace.vectors("model_force", "N")[rows], axis=1).mean()))


def main() -> None:
    run = tissue.simulate(tissue.load_scene("needle", {"duration_s": 1.5}))
    puncture_s = next(time for time, what in run.events if "capsule" in what)
    capsule = stimulus(run.trace, puncture_s - WINDOW_S - 1e-3)
    parenchyma = stimulus(run.trace, puncture_s + 1e-3)
    print(f"capsule {capsule.level_N:.2f} N, parenchyma {parenchyma.level_N:.2f} N")
    assert 1.9 < capsule.level_N < 2.3 and 1.5 < parenchyma.level_N < 1.8
    rng = np.random.default_rng(0)
    for group in HANDS:
        people = draw_observers(group, PEOPLE, rng)
        plain = share_right(people, capsule, parenchyma, seed=1)
        scaled = share_right(people, capsule, parenchyma, seed=1, commands=calibrated_commands(people, rng))
        gain = gain_of(plain, scaled, rng)
        print(
            f"{group}: error {100 * (1 - plain.mean()):.1f} %, with calibration {100 * (1 - scaled.mean()):.1f} %; "
            f"right answers change by {gain.value:+.1f} % ({gain.low:+.1f} to {gain.high:+.1f})"
        )
        assert plain.mean() > 0.9 and scaled.mean() > 0.9 and abs(gain.value) < 3.0
    typical = reference_observer()
    names = ("alpha", "beta", "kappa", "offset_N", "lapse", "sigma")
    same = SimulatedObservers(**{name: np.full(PEOPLE, getattr(typical, name)) for name in names})
    known = calibrated_commands(same, rng, numbers=0)
    plain, scaled = (share_right(same, capsule, parenchyma, seed=1, commands=each) for each in (None, known))
    print(f"reference: right answers change by {100 * abs(scaled - plain).max():.1f} %")
    assert (plain == scaled).all()


if __name__ == "__main__":
    main()
