"""Opens a folder of trajectories, from keycld or from elsewhere."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from keycld._errors import KeycldError, unknown
from keycld.data.format.derived import MOST_BYTES, picture_shape, refuse_if_large, with_pictures
from keycld.data.format.folder import CONSTRAINTS, read_statistics, unfinished
from keycld.data.format.reading import blocks, read, recordings
from keycld.data.format.rules import EVERY
from keycld.data.format.trajectories import Trajectories
from keycld.data.generate.make import provide
from keycld.data.generate.recipes import deferred
from keycld.data.generate.sweeps import Sweep, sweeps_of
from keycld.data.sample.resident import Resident
from keycld.data.sample.training_data import TrainingData
from keycld.systems import get, names

if TYPE_CHECKING:
    import keycld.mechanics


@dataclass(frozen=True)
class DataSet:
    """A folder of trajectories; nothing is read before it is needed, and nothing is kept.

    Attributes:
        folder: the path of the folder.
        constraints_file: the TOML file that `constraints` come from, or None for the suggestion of the system.
    """

    folder: Path
    constraints_file: Path | None

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the files, without .h5, and of those that are made when they are first needed."""
        return tuple(sorted([*(path.stem for path in self.folder.glob("*.h5")), *deferred(self.folder)]))

    def path(self, name: str) -> Path:
        """Return the file of a split; it is made now if `make_data` left it for when it is needed.

        Raises:
            KeycldError: the folder lacks it; or the folder may not be written, and as `make_data`.
        """
        path = self.folder / f"{name}.h5"
        provide(path)
        if not path.exists():
            raise KeycldError(f"{self.folder} has no {name}.h5, only {', '.join(self.splits)}: make or add it.")
        return path

    def count(self, name: str) -> int:
        """Count the trajectories of a split.

        Raises:
            KeycldError: the folder lacks the file, or it is damaged.
        """
        return recordings(self.path(name))

    def split(self, name: str, *, images: bool = True, rows: slice = EVERY) -> Trajectories:
        """Read the trajectories of one file, or some of them, with or without their pictures.

        Pictures that are not stored are rendered, if keycld has the renderer.

        Args:
            name: of the file, without .h5.
            images: False leaves `image` None.
            rows: which trajectories, such as `slice(0, 100)`.

        Raises:
            KeycldError: the folder lacks the file, something is wrong in it, or the pictures take too much memory.
        """
        path = self.path(name)
        shape = picture_shape(path, rows) if images else None
        if shape is not None:
            refuse_if_large(shape)
        trajectories = read(path, images=images, rows=rows)
        return with_pictures(trajectories) if images else trajectories

    def blocks(self, name: str, size: int = 16, *, images: bool = True) -> Iterator[Trajectories]:
        """Read the trajectories of one file in order, `size` at a time, for files that do not fit into memory.

        Args:
            name: of the file, without .h5.
            size: trajectories of a block; the last block may have fewer.
            images: False leaves `image` None; otherwise pictures that are not stored are rendered.

        Raises:
            KeycldError: as `split`.
        """
        found = blocks(self.path(name), size, images=images)
        return map(with_pictures, found) if images else found

    def training_data(
        self, seed: int, *, budget_bytes: int | float = MOST_BYTES, shard_steps: int = TrainingData.SHARD_STEPS
    ) -> TrainingData:
        """Prepare the training split for samplers: resident as a whole if it fits into memory, or shard by shard.

        Args:
            seed: decides which trajectories are resident together.
            budget_bytes: memory for the training data.
            shard_steps: steps until the next shard takes the place of the resident one.

        Raises:
            KeycldError: there is no training split, the budget is too small, or there are neither pictures nor a
                renderer.
        """
        return TrainingData(self.path("train"), seed, budget_bytes=budget_bytes, shard_steps=shard_steps)

    def resident(self, name: str = "train") -> Resident:
        """Put all trajectories of one file on the device: their pictures, or a renderer if only states are stored.

        Raises:
            KeycldError: they take too much memory, or there are neither pictures nor a renderer.
        """
        source = TrainingData(self.path(name), seed=0)
        if source.until(0) is not None:
            raise KeycldError(
                f"{source.shape[0]} trajectories of {self.folder} do not fit into memory: use training_data instead."
            )
        return source.at(0)

    def train(self) -> Trajectories:
        """Read the training split, from which models learn."""
        return self.split("train")

    def validation(self) -> Trajectories:
        """Read the validation split, on which choices are made and which gives the threshold ε."""
        return self.split("validation")

    def test(self) -> Trajectories:
        """Read the test split, on which nothing is ever tuned."""
        return self.split("test")

    def sweeps(self) -> tuple[Sweep, ...]:
        """Read the pictures along the paths of the energy figures; none if the folder has no sweeps.h5."""
        return sweeps_of(self.split("sweeps")) if "sweeps" in self.splits else ()

    @property
    def attributes(self) -> dict[str, Any]:
        """Root attributes of the first existing file of train, validation and test."""
        return dict(self._first.attributes)

    @property
    def system(self) -> str:
        """The name of the system."""
        return str(self.attributes["system"])

    @property
    def dt(self) -> float:
        """Seconds between frames."""
        return float(self.attributes["dt"])

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs; "input 1" and so on if the file does not name them, () if nothing drives the motion."""
        first = self._first
        numbered = tuple(f"input {k + 1}" for k in range(first.input.shape[-1]))
        named = first.attributes.get("input_names", numbered)
        return (named,) if isinstance(named, str) else tuple(named)

    @property
    def statistics(self) -> dict[str, Any] | None:
        """The contents of `statistics.json`, or None if there is none."""
        return read_statistics(self.folder)

    @property
    def constraints(self) -> "keycld.mechanics.Constraints | None":
        """The constraints on the keypoints; None without a constraints file and without a suggestion of the system."""
        if self.constraints_file is not None:
            from keycld.mechanics import load_constraints

            return load_constraints(self.constraints_file)
        name = self.system
        if name not in names() or not get(name).keypoints:
            return None
        return get(name).constraints

    @property
    def looks_differ(self) -> bool:
        """Whether the parts look different from recording to recording, as far as the system says."""
        return self.system in names() and get(self.system).looks_differ

    @property
    def parameters_differ(self) -> bool:
        """Whether masses, places or lengths differ from recording to recording, as far as the system says."""
        return self.system in names() and get(self.system).parameters_differ

    @property
    def keypoints(self) -> tuple[str, ...]:
        """Names of the keypoints, in the order of the constraints file or of the system; () if there are none."""
        found = self.constraints
        return () if found is None else found.keypoints

    @property
    def _first(self) -> Trajectories:
        """One trajectory, without its pictures."""
        for name in ("train", "validation", "test", *self.splits):
            if (self.folder / f"{name}.h5").exists():
                return read(self.path(name), images=False, rows=slice(0, 1))
        raise KeycldError(f"{self.folder} holds no .h5 file.")


def open_data(data: str | Path, *, constraints: str | Path | None = None) -> DataSet:
    """Open the data set of a system or in a folder.

    Args:
        data: the name of a system, which means the folder `data/NAME`, or a folder.
        constraints: a TOML file that replaces the `constraints.toml` of the folder and the suggestion of the system.

    Raises:
        KeycldError: no such system or folder, no data in it, or unfinished data.
    """
    folder = _folder(data)
    if not any(folder.glob("*.h5")):
        raise KeycldError(f"{folder} holds no .h5 file: make data there, or import a video into it.")
    if unfinished(folder):
        raise KeycldError(f"the data in {folder} are unfinished: run the command that made them once more.")
    if constraints is None:
        inside = folder / CONSTRAINTS
        return DataSet(folder, inside if inside.exists() else None)
    if not Path(constraints).is_file():
        raise KeycldError(f"there is no constraints file {constraints}: check the path.")
    return DataSet(folder, Path(constraints))


def _folder(data: str | Path) -> Path:
    path = Path(data)
    bare = isinstance(data, str) and path.name == data
    if data in names():
        made = Path("data") / data
        if not made.is_dir():
            raise KeycldError(f"there are no data of the {data} in {made}: make them with 'keycld data make {data}'.")
        return made
    if path.is_dir():
        return path
    if path.is_file() and path.suffix == ".h5":
        raise KeycldError(f"{path} is a file: give the folder that holds train.h5.")
    if path.is_file():
        raise KeycldError(
            f"{path} is not the folder of a data set: make one of a video with `keycld data import {path} --out "
            f"FOLDER`, or learn its physics with `keycld watch {path} --mechanism auto`."
        )
    if bare:
        raise unknown("system or folder", path.name, names(), listed="docs/systems.md and docs/datasets.md")
    raise KeycldError(f"there is no folder {path}: check the path.")
