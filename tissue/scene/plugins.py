"""Parts that installed packages offer by entry points: read once, when a table is asked for more
than it knows.
"""

import warnings
from functools import cache
from importlib.metadata import EntryPoint, entry_points

__all__ = ["OFFERED", "PluginWarning", "ask_packages", "offered_names", "refusal"]

OFFERED = {
    f"tissue.{kind}s": kind
    for kind in (
        "tool",
        "probe",
        "needle",
        "motion",
        "tissue",
        "device",
        "hand",
        "renderer",
        "predictor",
        "perception",
        "material",
        "scene",
    )
}
"""Groups of entry points, by the function of `tissue.register` that takes what one names."""
_asked: set[str] = set()
_refused: dict[tuple[str, str], str] = {}


class PluginWarning(UserWarning):
    """A part that an installed package offers cannot be used; all else goes on without it."""


def ask_packages(group: str) -> None:
    """Make known what installed packages offer in a group of entry points; once for each group.

    A part that cannot be had is left out with a `PluginWarning`, see `refusal`. Its name stays with
    who had it before: with what is built in, or was registered by a call.
    """
    if not group or group in _asked:
        return
    _asked.add(group)  # before any is imported, which may ask in its turn
    first: dict[str, EntryPoint] = {}
    for offer in _offers().get(group, ()):
        other = first.setdefault(offer.name, offer)
        if other is not offer:
            _refuse(
                offer, f"the package {_package(other)} offers one by that name, too, which is used"
            )
            continue
        try:
            from tissue import register

            register.offered(OFFERED[group], offer.name, offer.load)
        except (Exception, SystemExit) as error:
            reason = (str(error).splitlines() or [""])[0]
            cause = (
                reason
                if type(error).__name__ == "InputError"
                else f"{type(error).__name__}: {reason}"
            )
            _refused[group, offer.name] = _refuse(offer, cause)


def refusal(group: str, name: str) -> str | None:
    """Why a part that a package offers cannot be used; None where none by that name was refused."""
    return _refused.get((group, name))


def offered_names() -> dict[str, list[str]]:
    """Names of what installed packages offer, by kind, without importing any of them."""
    return {OFFERED[group]: [offer.name for offer in offers] for group, offers in _offers().items()}


def _refuse(offer: EntryPoint, cause: str) -> str:
    """Warn of an offer that is left out; the sentence."""
    what = f"{OFFERED[offer.group]} {offer.name} of the package {_package(offer)}"
    sentence = f"{what} cannot be used ({cause}): update or uninstall that package"
    warnings.warn(sentence, PluginWarning, stacklevel=4)
    return sentence


def _package(offer: EntryPoint) -> str:
    """Name and version of the package that offers it."""
    return offer.value if offer.dist is None else f"{offer.dist.name} {offer.dist.version}"


@cache
def _offers() -> dict[str, list[EntryPoint]]:
    """Entry points of all groups that are there."""
    installed = entry_points()
    found = {group: list(installed.select(group=group)) for group in OFFERED}
    return {group: offers for group, offers in found.items() if offers}
