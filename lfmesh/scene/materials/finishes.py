"""Finish of an interface: polished, diffuse, or ground to a roughness."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema

from lfmesh.scene.model import Fault, Model

SMOOTHEST = 1e-4
"""Roughness below which ground glass is traced as polished; its facets deflect light by a few tenths of a mrad."""

Roughness = Annotated[float, Field(strict=True, ge=0, le=1)]


class Finish(Model):
    """The finish of an interface; the name alone suffices if it has no parameters."""

    kind: Literal["polished", "diffuse", "ground"] = "polished"
    """Scatter of the interface: none, by the cosine law, or at microfacets. "polished": smooth. "diffuse": reflects and
    transmits by the cosine law, whatever the direction of the light. "ground": microfacets, each of which reflects and
    refracts like a smooth interface."""
    roughness: Roughness | None = None
    """Walter's α_g of the GGX distribution of "ground", 0..1 (no unit); a glTF roughness r is r². Half of the surface
    has a slope above it."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        if self.kind == "ground" and self.roughness is None:
            yield Fault(("roughness",), None, 'missing: give it, such as finish = { kind = "ground", roughness = 0.1 }')
        elif self.kind != "ground" and self.roughness is not None:
            yield Fault(("roughness",), self.roughness, f'omit it: kind = "{self.kind}" has none')

    @property
    def is_rough(self) -> bool:
        """True if the interface scatters light."""
        return self.kind != "polished" and (self.kind != "ground" or (self.roughness or 0.0) >= SMOOTHEST)

    def in_words(self) -> str:
        """Describe the finish.

        Returns
        -------
        str
        """
        parameters = self.model_dump(exclude={"kind"}, exclude_none=True)
        return ", ".join([self.kind, *(f"{key} {value:g}" for key, value in parameters.items())])


POLISHED = Finish()


def _as_table(value: Any) -> Any:
    """Accept a name as a finish without parameters."""
    return {"kind": value} if isinstance(value, str) else value


def _schema() -> dict[str, Any]:
    """Return the JSON schema of a finish: a name that needs no parameters, or a table."""
    fields = Finish.model_json_schema()["properties"]
    kinds: list[Any] = fields["kind"]["enum"]
    parameters = {key: field["anyOf"][0] for key, field in fields.items() if key != "kind"}
    table = {
        "type": "object",
        "properties": {"kind": {"enum": kinds, "type": "string"}, **parameters},
        "required": ["kind"],
        "additionalProperties": False,
    }
    alone = [kind for kind in kinds if not any(Finish.model_construct(kind=kind).faults())]
    return {"anyOf": [{"enum": alone, "type": "string"}, table]}


AnyFinish = Annotated[Finish, BeforeValidator(_as_table), WithJsonSchema(_schema())]
"""A finish in a scene file: a name or a table."""


def rough_phase(phase: object, finish: Finish, key: str) -> Iterator[Fault]:
    """Yield the fault of a face that has a phase and is rough.

    Parameters
    ----------
    phase : object
        Phase of the face, or None.
    finish : Finish
    key : str
        Key of the phase.
    """
    if phase is not None and finish.is_rough:
        yield Fault(
            (key,), None, f'omit it: the face has finish = "{finish.kind}", and scattered light has no single order'
        )


def both_given(coating: str, finish: Finish, key: str) -> Iterator[Fault]:
    """Yield the fault of a face that is both coated and rough.

    Parameters
    ----------
    coating : str
        Name of the coating.
    finish : Finish
    key : str
        Key of the finish.
    """
    if coating != "none" and finish.is_rough:
        yield Fault(
            (key,), finish.kind, f'the face also has coating = "{coating}", but a rough face has none: omit one of them'
        )
