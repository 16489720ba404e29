"""The unit of length of a surface file, which most formats do not hold: given, or guessed from its size."""

from meshes.base.errors import InputError, require_positive

__all__ = ["unit_of"]

_SMALLEST_MM, _LARGEST_MM = 1.0, 1000.0
_UNITS = (("millimetres", 1.0, 5.0, 700.0), ("metres", 1000.0, 0.005, 0.7))
_CENTIMETRES = (6.0, 60.0)
_TYPICAL_BONE_MM = 140.0


def unit_of(longest: float, scale_mm: float | None, source: str) -> tuple[float, str]:
    """Millimetres per file unit and how they were found, for a longest side in file units.

    Raises
    ------
    InputError
        If the scale given makes a bone of impossible size, or none is given where the size leaves the unit open.
    """
    plain = [scale for _, scale, lowest, highest in _UNITS if lowest <= longest <= highest]
    suggestion = plain[0] if plain else float(f"{_TYPICAL_BONE_MM / longest:.2g}")
    if scale_mm is not None:
        scale = require_positive("anatomy.scale_mm", scale_mm, "use 1 for millimetres, 1000 for metres")
        if not _SMALLEST_MM <= longest * scale <= _LARGEST_MM:
            raise InputError(
                f"anatomy.scale_mm must make the longest side 1 mm to 1 m, got {scale:g}, which makes "
                f"{source} {_length(longest * scale)} long: use about {suggestion:g}"
            )
        return scale, f"{scale:g} mm per unit, as given: the longest side is {longest * scale:.4g} mm"
    for name, scale, lowest, highest in _UNITS:
        if lowest <= longest <= highest:
            guess = f"{name}, since the longest side {longest:.3g} would be {longest * scale:.3g} mm"
            if name == "millimetres" and _CENTIMETRES[0] <= longest <= _CENTIMETRES[1]:
                guess += f" (in centimetres it would be {10 * longest:.3g} mm: set anatomy.scale_mm to be sure)"
            return scale, guess
    raise InputError(
        f"anatomy.scale_mm must be given where the unit is not plain, got none for {source}, whose "
        "longest side "
        f"{longest:.3g} would be {_length(longest)} in millimetres and {_length(1e3 * longest)} in "
        f"metres: use millimetres per unit, for example {suggestion:g}"
    )


def _length(millimetres: float) -> str:
    """Length in the unit a person would use."""
    for name, factor in (("km", 1e6), ("m", 1e3), ("mm", 1.0)):
        if millimetres >= factor:
            return f"{millimetres / factor:.3g} {name}"
    return f"{millimetres * 1e3:.3g} µm"
