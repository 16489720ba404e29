"""Colours and markers of methods and predictors in charts and in the report of a study."""

from collections.abc import Iterable
from itertools import cycle

from tissue.scene.registry import PREDICTORS

METHOD_LOOKS = {
    "penalty": ("#999933", "H"),
    "energy": ("#882255", "d"),
    "koopman-perception": ("#332288", "*"),
}
"""Colour and marker of the methods of a study that are not predictors (colours of Tol 2021).

The colours and markers of built-in predictors are in `PREDICTORS`.
"""
OWN_COLOURS = ("#56B4E9", "#8C564B", "#000000", "#7570B3")
OWN_MARKERS = ("X", "p", "h", "<", ">")
"""Markers of registered predictors, in the order of registration; `OWN_COLOURS` holds the colours.

No built-in predictor or method has one of these markers. Up to twenty registered predictors differ
in colour or marker.
"""


def looks(methods: Iterable[str] = ()) -> dict[str, tuple[str, str]]:
    """Return the colour and marker of every method and predictor, keyed by name.

    `methods` may contain further names. They follow the registered predictors.
    """
    found = {kind: (PREDICTORS[kind].colour, PREDICTORS[kind].marker) for kind in PREDICTORS}
    found |= METHOD_LOOKS
    own = [kind for kind in PREDICTORS if kind not in PREDICTORS.built_in]
    own += [method for method in methods if method not in found]
    for kind, colour, marker in zip(own, cycle(OWN_COLOURS), cycle(OWN_MARKERS), strict=False):
        found[kind] = (colour, marker)
    return found
