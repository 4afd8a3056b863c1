"""The air round the camera, where it is not that of the glass catalogues."""

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from lfmesh.optics.air import REFERENCE_C, REFERENCE_KPA, in_other_air
from lfmesh.scene.model import Model

if TYPE_CHECKING:
    from lfmesh.scene.scene import Scene

Celsius = Annotated[float, Field(strict=True, ge=-100, le=200)]
Kilopascal = Annotated[float, Field(strict=True, ge=0, le=1000)]


class Air(Model):
    """Temperature and pressure of dry air, relative to which glasses then have their indices."""

    temperature_c: Celsius = REFERENCE_C
    """Temperature, in °C. Of the air alone: the glasses stay as they are at 20 °C."""
    pressure_kpa: Kilopascal = REFERENCE_KPA
    """Pressure, in kPa; 0 is vacuum."""

    def index_of(self, index: float, wavelength_nm: float) -> float:
        """Return a catalogue's index of a glass relative to this air."""
        return in_other_air(index, wavelength_nm, self.temperature_c, self.pressure_kpa)

    def in_words(self) -> str:
        """Describe the air."""
        return (
            f"in air of {self.temperature_c:g} °C and {self.pressure_kpa:g} kPa" if self.pressure_kpa else "in vacuum"
        )


def in_its_air(scene: "Scene") -> "Scene":
    """Return a scene whose `camera.air` is used up: every glass says itself in which air it stands.

    A scene without that key comes back as it is. Numbers in `index` stay, as does a glass that has an `air` of its own.
    """
    air = scene.camera.air
    if air is None:
        return scene
    camera = scene.camera
    lens = camera.lens.model_copy(
        update={"surfaces": tuple(_placed(_placed(each, air), air, "refractor") for each in camera.lens.surfaces)}
    )
    mla = _placed(camera.mla, air)
    sensor = _placed(camera.sensor, air, "cover")
    tanks = tuple(_placed(_placed(tank, air, "wall"), air, "liquid") for tank in scene.tanks)
    return scene.model_copy(
        update={
            "camera": camera.model_copy(update={"air": None, "lens": lens, "mla": mla, "sensor": sensor}),
            "targets": tuple(_placed(target, air, "refractor") for target in scene.targets),
            "tanks": tanks,
        }
    )


def _placed(model: Any, air: Air, part: str | None = None) -> Any:
    """Return a model whose glass, or that of one of its parts, stands in some air."""
    from lfmesh.scene.own_glass import OwnGlass  # which has this module's Air

    if part is not None:
        return model.model_copy(update={part: _placed(getattr(model, part), air)})
    if model is None or model.glass is None:
        return model
    glass = OwnGlass(name=model.glass) if isinstance(model.glass, str) else model.glass
    return model if glass.air is not None else model.model_copy(update={"glass": glass.model_copy(update={"air": air})})
