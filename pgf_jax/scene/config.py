"""Settings of the command `scene`."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from pgf_jax.errors import BadInput
from pgf_jax.scene.sampling import SceneClass, Sizes, sizes_of
from pgf_jax.settings import MAX_SEED, Bounds, Count, Seed, check_fields, check_int

Range = Annotated[tuple[float, float] | None, Bounds(0)]


@dataclasses.dataclass(frozen=True)
class SceneCommand:
    """Check scenes, and draw them: from files, or sampled ones, which are written as files too.

    Attributes:
      scene: scene files to check, *.json or *.xml (MJCF).
      scene_class: sample scenes of this class instead of reading files; None: the files' scenes.
      seed: seed of the first sampled scene; the next scenes count on from there.
      count: how many scenes to sample.
      objects: how many objects, low and high. This and the sizes below are for the classes crowded,
        packed and mixed. None: the class's own.
      radius: of the objects, low and high, m. None: the class's own.
      height: of the objects, low and high, m; at most four radii. None: the class's own.
      mass: of the objects, low and high, kg. None: the class's own.
      table_friction: coefficients of the objects on the table, low and high. None: the class's own.
      friction: coefficients of the objects and other bodies, low and high. None: the class's own.
      width: of the shelf, between its side walls, m. None: the class's own.
      depth: of the shelf, from its front to the back wall, m. None: the class's own.
      out: folder for a picture of each scene, NAME.png, and of sampled ones a file, NAME.json;
        None: nothing is written.
    """

    scene: tuple[Path, ...] = ()
    scene_class: Annotated[SceneClass | None, tyro.conf.arg(aliases=["--preset"])] = None
    seed: Seed = 0
    count: Count = 1
    objects: tuple[int, int] | None = None
    radius: Range = None
    height: Range = None
    mass: Range = None
    table_friction: Range = None
    friction: Range = None
    width: Annotated[float | None, Bounds(0)] = None
    depth: Annotated[float | None, Bounds(0)] = None
    out: Path | None = None

    GROUPS = (  # of options, for the help
        ("scenes", ("scene", "scene_class", "count", "seed")),
        ("sizes", tuple(field.name for field in dataclasses.fields(Sizes))),
        ("output", ("out",)),
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if bool(self.scene) == (self.scene_class is not None):
            got = "both" if self.scene else "neither"
            raise BadInput(f"--scene, --scene-class: expected one of the two, got {got}")
        if self.scene and self.count != 1:
            raise BadInput(f"count: goes with scene_class only, got {self.count} with scene files")
        check_int("seed", self.seed, 0, MAX_SEED - self.count + 1)
        if self.given and self.scene:
            raise BadInput(f"{next(iter(self.given))}: goes with scene_class only")
        self.sizes  # noqa: B018  BadInput if they cannot be

    @property
    def given(self) -> dict[str, object]:
        """The sizes that are given."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(Sizes)}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def sizes(self) -> Sizes | None:
        """Sizes of sampled scenes; None: the class's own."""
        if not self.given or self.scene_class is None:
            return None
        return dataclasses.replace(sizes_of(self.scene_class), **self.given)  # pyright: ignore[reportArgumentType]
