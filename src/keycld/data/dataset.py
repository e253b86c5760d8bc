"""Opens a folder of trajectories, whoever made it."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from keycld._errors import KeycldError, unknown
from keycld.data.clips import Resident, TrainingData, resident
from keycld.data.drawn import with_pictures
from keycld.data.rules import EVERY
from keycld.data.statistics import read_statistics
from keycld.data.store import Trajectories, read, recordings
from keycld.data.sweeps import Sweep, sweeps_of
from keycld.systems import AbstractSystem, get, names

if TYPE_CHECKING:
    import keycld.mechanics

PARTIAL = ".partial"
CONSTRAINTS = "constraints.toml"


@dataclass(frozen=True)
class DataSet:
    """A folder of trajectories; nothing is read before it is asked for, and nothing is kept.

    Attributes:
        folder: where it lies.
        constraints_file: the TOML file that `constraints` come from, or None for the system's suggestion.
    """

    folder: Path
    constraints_file: Path | None

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the files, without .h5."""
        return tuple(sorted(path.stem for path in self.folder.glob("*.h5")))

    def path(self, name: str) -> Path:
        """The file of a split.

        Raises:
            KeycldError: the folder lacks it.
        """
        if name not in self.splits:
            raise KeycldError(f"{self.folder} has no {name}.h5, only {', '.join(self.splits)}: make or add it.")
        return self.folder / f"{name}.h5"

    def count(self, name: str) -> int:
        """How many trajectories the file of a split holds.

        Raises:
            KeycldError: the folder lacks the file, or it is damaged.
        """
        return recordings(self.path(name))

    def split(self, name: str, *, images: bool = True, rows: slice = EVERY) -> Trajectories:
        """The trajectories of one file, or some of them, with or without their pictures.

        Pictures that are not stored are drawn, where a renderer of ours draws them.

        Args:
            name: of the file, without .h5.
            images: False leaves `image` None.
            rows: which trajectories, such as `slice(0, 100)`.

        Raises:
            KeycldError: the folder lacks the file, something is wrong in it, or drawing takes too much memory.
        """
        trajectories = read(self.path(name), images=images, rows=rows)
        return with_pictures(trajectories) if images else trajectories

    def resident(self, name: str = "train") -> Resident:
        """The trajectories of one file on the device, for samplers: pictures, or what draws them from the states.

        Raises:
            KeycldError: as `split`, and where there are neither pictures nor a renderer of ours.
        """
        return resident(read(self.path(name)))

    def training_data(self, seed: int) -> TrainingData:
        return TrainingData(self.resident())

    def train(self) -> Trajectories:
        """What models learn from."""
        return self.split("train")

    def validation(self) -> Trajectories:
        """What choices are made on, and what the threshold ε comes from."""
        return self.split("validation")

    def test(self) -> Trajectories:
        """What nothing is ever tuned on."""
        return self.split("test")

    def sweeps(self) -> tuple[Sweep, ...]:
        """Pictures along the paths of the energy figures; none where the folder has no sweeps.h5."""
        return sweeps_of(self.split("sweeps")) if "sweeps" in self.splits else ()

    @property
    def attributes(self) -> dict[str, Any]:
        """Root attributes of the first of train, validation, test that is there."""
        for name in ("train", "validation", "test", *self.splits):
            if name in self.splits:
                return dict(read(self.path(name), images=False, rows=slice(0, 1)).attributes)
        raise KeycldError(f"{self.folder} holds no .h5 file.")

    @property
    def system(self) -> str:
        """The name of what moves."""
        return str(self.attributes["system"])

    @property
    def dt(self) -> float:
        """Seconds between frames."""
        return float(self.attributes["dt"])

    @property
    def statistics(self) -> dict[str, Any] | None:
        """What `statistics.json` says, or None where there is none."""
        return read_statistics(self.folder)

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """The constraints on the keypoints.

        Raises:
            KeycldError: there is neither a constraints file nor a known system.
        """
        if self.constraints_file is not None:
            from keycld.mechanics import load_constraints

            return load_constraints(self.constraints_file)
        return self._known_system().constraints

    @property
    def keypoints(self) -> tuple[str, ...]:
        """Names of the keypoints, in the order of the constraints file or of the system."""
        return self.constraints.keypoints

    def _known_system(self) -> AbstractSystem:
        name = self.system
        if name in names():
            return get(name)
        raise KeycldError(
            f"no keypoints are known for '{name}': put a {CONSTRAINTS} into {self.folder}, or give one with "
            "--constraints FILE.toml (docs/data.md shows one)."
        )


def open_data(data: str | Path, *, constraints: str | Path | None = None) -> DataSet:
    """Open the data set of a system or in a folder.

    Args:
        data: a system's name, which means the folder `data/NAME`, or a folder.
        constraints: a TOML file that replaces the folder's `constraints.toml` and the system's suggestion.

    Raises:
        KeycldError: no such system or folder, no data in it, or unfinished data.
    """
    folder = _folder(data)
    if not any(folder.glob("*.h5")):
        raise KeycldError(f"{folder} holds no .h5 file: make data there, or import a video into it.")
    if unfinished(folder):
        raise KeycldError(f"the data in {folder} are unfinished: run the command that made them once more.")
    if constraints is None:
        beside = folder / CONSTRAINTS
        return DataSet(folder, beside if beside.exists() else None)
    if not Path(constraints).is_file():
        raise KeycldError(f"there is no constraints file {constraints}: check the path.")
    return DataSet(folder, Path(constraints))


def unfinished(folder: Path) -> bool:
    """Whether the making of the data there was interrupted."""
    return (folder / PARTIAL).exists() and not (folder / "statistics.json").exists()


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
    if path.is_file():
        raise KeycldError(f"{path} is a file: give the folder that holds train.h5.")
    if bare:
        raise unknown("system or folder", path.name, names())
    raise KeycldError(f"there is no folder {path}: check the path.")
