"""World, run and light field that all pages of a server show, read once and changed by none of them."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from lfmesh.files import run
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.transport.render.image import Image
from lfmesh.view.browser.field_views import FieldViews, calibration_of_run
from lfmesh.view.request import Subject, sensor_picture, subject_of

if TYPE_CHECKING:
    from lfmesh.scene import Scene
    from lfmesh.transport.world import World
    from lfmesh.view.rays.paths import Rays


@dataclass(frozen=True)
class PageSubject:
    """A scene, or a run with its image and light field.

    Attributes
    ----------
    seen : Subject
    image : Image or None
        The run's.
    folder : Path or None
        The run's.
    rays : Rays or None
        Drawn from the start.
    """

    seen: Subject
    image: Image | None
    folder: Path | None
    rays: "Rays | None"

    @classmethod
    def read(
        cls, subject: "Scene | World | Image | str | os.PathLike[str]", rays: "Rays | None" = None
    ) -> "PageSubject":
        """Read a subject.

        Raises
        ------
        LfmeshError
            There is no such scene or run, or it is damaged.
        """
        folder = Path(subject) if isinstance(subject, str | os.PathLike) and Path(subject).is_dir() else None
        image = run.open_run(folder) if folder is not None else subject if isinstance(subject, Image) else None
        if rays is not None:
            seen = Subject(rays.world, sensor_picture(image) if image is not None else None)
        else:
            seen = subject_of(subject if image is None else image)
        return cls(seen, image, folder, rays)

    @property
    def scene(self) -> "Scene":
        """Solved."""
        return self.seen.world.scene

    @cached_property
    def calibration(self) -> Calibration:
        """Places of the micro-images; tracing them takes seconds for a large array."""
        return calibration_of_run(self.scene, self.folder)

    @cached_property
    def field_views(self) -> FieldViews:
        """The run's light field.

        Raises
        ------
        LfmeshError
            A file of the run is damaged, or its camera records no light field.
        """
        assert self.image is not None
        assert self.folder is not None
        return FieldViews(self.image, self.folder, self.calibration)
