"""Warnings about gradient-index lenslets that image a plane onto the sensor."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lfmesh.scene.camera.lenslet_optics import main_section, sections
from lfmesh.scene.first_order.paraxial import ROUNDED
from lfmesh.scene.first_order.relay import FOCUSED_BLUR_PX, conjugate, relay_of
from lfmesh.scene.scene import Scene

if TYPE_CHECKING:
    from lfmesh.scene.first_order.report import FirstOrder


def relay_warnings(scene: Scene, facts: "FirstOrder") -> Iterator[str]:
    """Yield the warnings about a solved scene.

    Parameters
    ----------
    scene : Scene
    facts : FirstOrder
    """
    mla, pixel = scene.camera.mla, scene.camera.sensor.pixel_mm
    imaged = conjugate(scene.camera, scene.primary_nm)
    if mla is None or imaged is None:
        return
    magnification, before = imaged
    side = f"{-before:.4g} mm behind" if before < 0.0 else f"{before:.4g} mm before"
    relay = relay_of(scene.camera, scene.primary_nm)
    if relay is not None:
        if not relay.joins(scene.camera):
            apart = abs(1.0 - magnification) * mla.pitch_mm
            yield (
                f"the lenslets image their plane {magnification:.4g} times as large, so their images do not join: "
                f"neighbours image a point {apart:.4g} mm ({apart / pixel:.3g} pixels) apart, all its images lie "
                f"within {relay.spread_mm(mla):.4g} mm. Sampling, Airy disk and depth of field are for one lenslet"
            )
        several = [f"{mla.types} types"] if mla.types > 1 else []
        several += ["different power in x and y"] if len(sections(mla)) > 1 else []
        if several:
            main = main_section(scene.camera, scene.primary_nm)
            yield (
                f"the lenslets have {' and '.join(several)}: plane in focus, sampling and field of view are for the "
                f"first type in the {main}–z section. The others image other planes"
            )
    elif facts.focused:
        if any(abs(at.to_sensor_mm) * ROUNDED > 1e-3 * pixel for at in facts.focused):
            yield (
                "the lenslets are afocal, with principal planes at infinity: the plane in focus and the figures of the "
                f"lenslets are not known. They image a plane {side} the array's first face, with a magnification of "
                f"{magnification:.4g}"
            )
    elif abs(magnification) * mla.pitch_mm > FOCUSED_BLUR_PX * pixel and math.isfinite(before):
        yield (
            f"the lenslets do not image the pupil onto the sensor, but a plane {side} the array's first face, "
            f"{magnification:.4g} times as large: the plane in focus and the micro-images are not those reported"
        )
