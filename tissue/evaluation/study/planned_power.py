"""Power of the tests that a plan states, in closed form, before there is a trial."""

from scipy.stats import f, ncf

from meshes.base.errors import require_range

__all__ = ["EFFECT", "planned_power"]

EFFECT = 1.0
"""Effect of interest: one standard deviation, of the differences within people between two methods, or of people of one
group. Chosen, range 0.5 to 2: the least that matters here, as the paper's force errors of penalty and Koopman differ by
2.8 to 2.9 standard deviations (its table of force errors, root mean square of both columns' spreads)."""


def planned_power(people: int, groups: int, methods: int, *, alpha: float, effect: float = EFFECT) -> dict[str, float]:
    """Chance that each test of one metric on one task finds an effect of interest, by the noncentral F distribution.

    One method, or one group, or one method in one group, differs by ``effect`` from the rest, which are equal. With n
    people in each of g groups under k methods, normal effects and sphericity, the noncentralities (Cohen 1988, chapter
    8; of the exact tests in `tissue.evaluation.statistics.strata`) are::

        method          2 g n d² (k - 1) / k                    degrees k - 1, (g n - g) (k - 1)
        group           n d² (g - 1) / g                        degrees g - 1, g n - g
        group x method  2 n d² (k - 1) / k (g - 1) / g          degrees (g - 1) (k - 1), (g n - g) (k - 1)

    Parameters
    ----------
    people
        People in a group, n. The effect is on means over a person's trials, so that trials do not count beside them.
    groups, methods
        Numbers of both, g and k.
    alpha
        Share of false alarms of one test, after correction.
    effect
        Effect d in standard deviations.

    Returns
    -------
    dict[str, float]
        Power by test; none for a test that so few people, groups or methods do not allow.

    Raises
    ------
    InputError
        If alpha or the effect is out of range.
    """
    require_range("alpha", alpha, 1e-9, 1.0, "use 0.05")
    require_range("effect", effect, 0.01, 10.0, "use 1")
    found: dict[str, float] = {}
    if people < 2:
        return found
    error = groups * (people - 1)
    across, between = (methods - 1) / methods, (groups - 1) / groups
    for name, noncentrality, above, below in (
        ("method", 2.0 * groups * people * effect**2 * across, methods - 1, error * (methods - 1)),
        ("group", people * effect**2 * between, groups - 1, error),
        (
            "group x method",
            2.0 * people * effect**2 * across * between,
            (groups - 1) * (methods - 1),
            error * (methods - 1),
        ),
    ):
        if above:
            found[name] = float(ncf.sf(f.isf(alpha, above, below), above, below, noncentrality))
    return found
