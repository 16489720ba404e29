"""Loading of parts, such as tools and devices, from entry points of installed packages.

The entry points are read once, when a name is unknown or all names are requested.
"""

import warnings
from functools import cache
from hashlib import sha256
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path

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
"""Methods of `tissue.register` that register parts, keyed by group of entry points."""
_asked: set[str] = set()
_refused: dict[tuple[str, str], str] = {}


class PluginWarning(UserWarning):
    """Warning that a part of an installed package cannot be used and is left out."""


def ask_packages(group: str) -> None:
    """Register all parts that installed packages offer in a group of entry points.

    Each group is read only once. A part that cannot be used is left out with a `PluginWarning`; see
    `refusal`. If a part with the same name is already registered, that part is kept.
    """
    if not group or group in _asked:
        return
    _asked.add(group)  # before an import that may call this function
    first: dict[str, EntryPoint] = {}
    for offer in _offers().get(group, ()):
        other = first.setdefault(offer.name, offer)
        if other is not offer:
            _refuse(offer, f"the package {_package(other)} offers the same name and is used")
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
    """Return the reason why a part in a group of entry points was left out, or None."""
    return _refused.get((group, name))


def offered_names() -> dict[str, list[str]]:
    """Return the names of the parts in entry points of installed packages, keyed by kind of part.

    The parts are not imported.
    """
    return {OFFERED[group]: [offer.name for offer in offers] for group, offers in _offers().items()}


def package_of(group: str, name: str) -> str:
    """Return the package that offers a part, with its version and the hash of its Python files.

    The result is empty if no package offers the part.
    """
    offer = next((each for each in _offers().get(group, ()) if each.name == name), None)
    spec = find_spec(offer.module.partition(".")[0]) if offer is not None else None
    if offer is None or spec is None:
        return ""
    folders = [Path(each) for each in spec.submodule_search_locations or ()]
    files = [path for folder in folders for path in sorted(folder.rglob("*.py"))]
    digest = sha256()
    for path in files or [Path(str(spec.origin))]:
        digest.update(path.read_bytes())
    # 16 digits distinguish versions of the code
    return f"{_package(offer)}, SHA-256 {digest.hexdigest()[:16]}"


def _refuse(offer: EntryPoint, cause: str) -> str:
    """Warn that the part of an entry point is left out; return the text of the warning."""
    what = f"{OFFERED[offer.group]} {offer.name} of the package {_package(offer)}"
    sentence = f"{what} cannot be used ({cause}). Update or uninstall that package"
    # Level 4 is the code that used the name through `Registry`.
    warnings.warn(sentence, PluginWarning, stacklevel=4)
    return sentence


def _package(offer: EntryPoint) -> str:
    """Return the name and version of the package to which an entry point belongs."""
    return offer.value if offer.dist is None else f"{offer.dist.name} {offer.dist.version}"


@cache
def _offers() -> dict[str, list[EntryPoint]]:
    """Return the installed entry points, keyed by group."""
    installed = entry_points()
    found = {group: list(installed.select(group=group)) for group in OFFERED}
    return {group: offers for group, offers in found.items() if offers}
