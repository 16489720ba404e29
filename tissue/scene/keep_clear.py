"""What a scene states of structures that the tool must not touch."""

from typing import Annotated

from pydantic import Field, StringConstraints, model_validator

from meshes.base.errors import InputError
from tissue.scene.part import Part

__all__ = ["KeepClear"]

Name = Annotated[str, StringConstraints(pattern=r"^[a-z0-9][a-z0-9_]*$")]


class KeepClear(Part):
    """Structures that the tool must not touch: their distance is in the trace, a breach is an
    event.
    """

    names: tuple[Name, ...] = Field((), strict=False, examples=[("canal",)])
    """Structures that the anatomy knows by name, such as a vertebra's canal."""
    files: dict[Name, str] = Field(default_factory=dict, examples=[{"canal": "canal.ply"}])
    """Closed surface of each other structure, in the frame and unit of `anatomy.file`, or of the
    site in mm.
    """

    @model_validator(mode="after")
    def _states_some(self) -> "KeepClear":
        if not self.names and not self.files:
            raise InputError(
                "keep_clear", "state names or files", "neither", "remove it, or name a structure"
            )
        both = set(self.names) & set(self.files)
        if both or len(set(self.names)) < len(self.names):
            twice = ", ".join(sorted(both or self.names))
            raise InputError(
                "keep_clear", "name each structure once", f"{twice} twice", "remove one"
            )
        return self
