"""Hostile files, full disks and kills: the quick part of `validation/faults`."""

import errno
import fcntl
import json
import os
import resource
import runpy
import signal
import struct
import subprocess
import sys
import threading
import time
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest

from data.sample import sample
from keycld import KeycldError
from keycld._files import alive, checked_name, read_bytes, write_text
from keycld._records import Name, NumberText, Unexpected, checked, read_arrays
from keycld.cli.main import main
from keycld.cli.start import after_an_end
from keycld.data import check, import_video, read, write
from keycld.data.format.hdf5 import create_file
from keycld.drawing import load_image, save_image, save_movie
from keycld.reports import html

REPOSITORY = Path(__file__).parent.parent


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "../a", "/a", "a\\b", "a\0b", "a\nb", "a" * 101, 3, None])
def test_a_name_cannot_lead_to_another_folder(name):
    with pytest.raises(KeycldError, match="a name has 1 to 100"):
        checked_name(name, "a.h5")


def test_names_of_results_are_names():
    for name in ("test@50-given-5", "rotation", "zoo four", "α"):
        assert checked_name(name, "a.h5") == name


def test_devices_and_folders_are_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "null").symlink_to("/dev/null")
    for name in ("pipe", "folder", "null"):
        with pytest.raises(KeycldError, match="stays as it is"):
            write_text(tmp_path / name, "")
    with pytest.raises(KeycldError, match="no regular file"):
        read_bytes(tmp_path / "pipe")


def test_the_number_of_a_thread_is_that_of_no_process():
    """Threads take numbers from the same sequence, so a dead writer's number may be that of a thread by now."""
    waits = threading.Event()
    thread = threading.Thread(target=waits.wait)
    thread.start()
    try:
        assert thread.native_id is not None
        os.kill(thread.native_id, 0)  # the system answers for it
        assert not alive(thread.native_id) and alive(os.getpid()) and alive(os.getppid())
    finally:
        waits.set()
        thread.join()


def test_what_a_dead_process_left_is_removed_and_a_living_one_keeps_its_own(tmp_path):
    dead = subprocess.Popen(["true"])
    dead.wait()
    host = os.uname().nodename
    names = (f".a.{dead.pid}@{host}.partial", f".a.{dead.pid}.partial", f".a.{os.getppid()}@{host}.partial",
             f".a.{dead.pid}@elsewhere.partial", f".ab.{dead.pid}@{host}.partial")  # fmt: skip
    for name in names:
        (tmp_path / name).mkdir()
    write_text(tmp_path / "a", "")
    assert sorted(os.listdir(tmp_path)) == sorted(["a", *names[2:]])


def test_a_bench_run_that_was_killed_at_its_first_file_is_not_moved_aside(tmp_path):
    from keycld.benchmarks.child import _set_aside

    dead = subprocess.Popen(["true"])
    dead.wait()
    (tmp_path / "run" / f".bench.json.{dead.pid}@{os.uname().nodename}.partial").mkdir(parents=True)
    _set_aside(tmp_path / "run", "")
    assert [path.name for path in tmp_path.rglob("*")] == ["run"]


def test_what_killed_experiments_left_hidden_goes_although_they_are_done(tmp_path):
    from keycld.benchmarks import Place, run_experiments, suite_named

    dead = subprocess.Popen(["true"])
    dead.wait()
    [experiment] = suite_named("keycld").select(systems=("pendulum",), models=("keycld",), seeds=(0,))
    place = Place(tmp_path / "root", tmp_path / "results")
    for file in (place.run(experiment) / "evaluation" / "test@50.json", place.result(experiment)):
        (file.parent / f".{file.name}.{dead.pid}@{os.uname().nodename}.partial").mkdir(parents=True)
    run_experiments([experiment], place, child=("true",), say=lambda line: None)
    assert not list(tmp_path.rglob(".*.partial"))


def test_what_a_maker_left_that_was_killed_after_its_last_file_goes_when_its_data_are_used(tmp_path, monkeypatch):
    from keycld.cli.making import data_for

    dead = subprocess.Popen(["true"])
    dead.wait()
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "data" / "pendulum"
    folder.mkdir(parents=True)
    (folder / "train.h5").touch()
    (folder / f".statistics.json.{dead.pid}@{os.uname().nodename}.partial").mkdir()
    assert data_for("pendulum") == "pendulum" and os.listdir(folder) == ["train.h5"]


def test_a_bench_run_that_was_killed_before_its_verdict_gets_one(tmp_path, monkeypatch):
    import keycld.training
    from keycld.benchmarks import Place, suite_named
    from keycld.benchmarks.child import train_model
    from keycld.training.run_files import write_verdict

    place, experiment = Place(tmp_path, tmp_path / "results"), suite_named("keycld").select()[0]
    calls = []
    monkeypatch.setattr(keycld.training, "finished", lambda run: True)
    monkeypatch.setattr(keycld.training, "train", lambda *arguments, **options: calls.append(arguments))
    train_model(experiment, place)
    place.run(experiment).mkdir(parents=True)
    write_verdict(place.run(experiment), [], passed=True)
    train_model(experiment, place)
    assert len(calls) == 1


@pytest.fixture
def small_files():
    """No file may become larger than 20 kB, as on a disk that fills up."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


NOISE = np.random.default_rng(0).integers(0, 255, (40, 64, 64, 3), np.uint8)


@pytest.mark.parametrize("name", ["a.h5", "a.png", "a.mp4", "a.gif", "a.txt"])
def test_a_disk_that_fills_up_leaves_the_old_file(tmp_path, small_files, name):
    path = tmp_path / name
    path.write_text("old")
    with pytest.raises(KeycldError, match="larger than|disk is full|cannot write"):
        if name == "a.h5":
            with create_file(path) as file:
                for k in range(40):
                    file.create_dataset(str(k), data=NOISE[k])
        elif name == "a.png":
            save_image(path, np.concatenate(NOISE))
        elif name == "a.txt":
            write_text(path, "long " * 10_000)
        else:
            save_movie(path, NOISE, scale=1)
    assert path.read_text() == "old" and os.listdir(tmp_path) == [name]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_quota_is_a_full_disk(tmp_path, number, monkeypatch):
    (tmp_path / "a.txt").write_text("old")

    def refuses(*arguments, **options):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "write_text", refuses)
    with pytest.raises(KeycldError, match="the disk is full while writing"):
        write_text(tmp_path / "a.txt", "new")
    assert (tmp_path / "a.txt").read_text() == "old" and os.listdir(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("refused", range(1, 5))
def test_a_quota_that_refuses_a_new_name_leaves_the_old_result(tmp_path, refused, monkeypatch):
    """On btrfs a folder at its quota lets files be removed, but not renamed."""
    from keycld.evaluation import Evaluation, save_evaluation

    def saved(number):
        save_evaluation(tmp_path, "test", Evaluation({"a": number}, {"z": np.full(9, number)}))

    def replace(source, target, replace=os.replace):
        calls.append(target)
        if len(calls) == refused:
            raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))
        replace(source, target)

    saved(1)
    folder, calls = tmp_path / "evaluation", []
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(KeycldError, match="the disk is full while writing"):
        saved(2)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    saved(2)
    assert json.loads((folder / "test.json").read_text()) == {"a": 2} and np.load(folder / "test.npz")["z"][0] == 2


def spoil(path, change):
    write(path, sample())
    with h5py.File(path, "r+") as file:
        change(file)


def external(file):
    del file["image"]
    file.create_dataset("image", (3, 5, 8, 8, 3), "u1", external=[("/etc/passwd", 0, 2880)])


def linked(file):
    del file["image"]
    file["image"] = h5py.ExternalLink("/etc/passwd", "/image")


def virtual(file):
    del file["state"]
    layout = h5py.VirtualLayout((3, 5, 4), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "state", (3, 5, 4))
    file.create_virtual_dataset("state", layout)


def huge(file):
    del file["image"]
    file.create_dataset("image", (10**9, 5, 8, 8, 3), "u1", chunks=(1, 5, 8, 8, 3))


def wide(file):
    del file["input"]
    file.create_dataset("input", (3, 10**9), "f4", chunks=(1, 1000))


@pytest.mark.parametrize(
    ("change", "words"),
    [(external, "in other files"), (linked, "is a link"), (virtual, "in other files"), (huge, "claims"),
     (wide, "claims")],
)  # fmt: skip
def test_a_data_file_reads_no_other_and_claims_no_more_than_it_holds(tmp_path, change, words):
    spoil(tmp_path / "a.h5", change)
    assert words in check(tmp_path / "a.h5")[0]
    with pytest.raises(KeycldError, match=words):
        read(tmp_path / "a.h5")


def test_records():
    assert checked({"a": 1}, dict[str, float]) == {"a": 1.0}
    for value, kind in (("1", int), (True, int), (1e400, float), ({"a": "b"}, dict[str, int]), ([1], tuple[int, int])):
        with pytest.raises(Unexpected):
            checked(value, kind)
    with pytest.raises(KeycldError):
        checked("../a", Name, "x")


def test_an_array_that_claims_more_than_its_bytes_is_refused(tmp_path):
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 8), }".ljust(117) + b"\n"
    import zipfile

    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(KeycldError, match="claims"):
        read_arrays(tmp_path / "a.npz", {}, "make it again")


def test_damage_is_reported_under_the_name_of_its_file(tmp_path):
    from keycld.evaluation import Evaluation, load_evaluation, save_evaluation

    save_evaluation(tmp_path, "sweeps", Evaluation({}, {"names": np.array(["turn"])}))
    with pytest.raises(KeycldError, match=r"sweeps\.npz is damaged"):
        load_evaluation(tmp_path, "sweeps")
    (tmp_path / "evaluation/sweeps.json").write_text('{"protocol": 1}')
    with pytest.raises(KeycldError, match=r"sweeps\.json is damaged"):
        load_evaluation(tmp_path, "sweeps")


def test_damaged_values_of_results_and_settings_are_refused_or_left_out(tmp_path):
    """Each ended in an error that nothing foresaw."""
    from keycld.benchmarks.results import Result
    from keycld.evaluation.probe import fit_probe
    from keycld.evaluation.stored import check_arrays, required
    from keycld.models import config_for
    from keycld.reports.training_figure import terms
    from keycld.systems import get

    for settings in ({"terms": 30}, {"terms": [1]}):
        with pytest.raises(KeycldError, match="terms of preset 'fast' does not take"):
            config_for("keycld", "fast", **settings)
    for settings in (
        {"constraints": 3},
        {"vision": {"constraint": [1.0, 2.0, 3.0]}},
        {"sigma": 1e308},
        {"shared_constants": 1},
    ):
        with pytest.raises(KeycldError, match="takes a|TOML text"):
            config_for("keycld", "fast", **settings).completed()
    for settings in ({"sigma": 1e30}, {"sigma": 1e-320}, {"width": 2**31}):
        with pytest.raises(KeycldError, match=r"is 0 or between 1e-12 and 1e12, a count below 2\^31"):
            config_for("keycld", "fast", **settings)
    with pytest.raises(KeycldError, match="TOML text"):
        config_for("keycld", "fast", constraints=[]).completed()
    assert list(terms([{"step": 1, "loss": 1.0, "a": 10**31, "b": 1e308}])) == ["loss"]
    with pytest.raises((Unexpected, KeyError)):
        check_arrays({}, {"turn/values": np.zeros(1)})
    assert "error_no_motion" in required({"skeleton": {}, "baselines": {"no motion": {}}})
    motion = {"skeleton": {}, "n": 1, "frames": 3, "keypoints": ["tip"], "baselines": {}}
    with pytest.raises(Unexpected, match="observed_course"):
        check_arrays(motion, {"shown_index": np.zeros(1, int), "observed_course": np.zeros((3, 1, 2))})
    for name, fits in (("1", True), ("0.25", True), ("<script>", False), ("nan", False), ("-1", False)):
        assert _is_checked({name: 1.0}, dict[NumberText, float]) == fits
    with pytest.raises(KeycldError, match="not finite"):
        fit_probe(get("pendulum"), np.full((2, 1, 2), np.nan), np.zeros((2, 2)), np.zeros((1, 2)), np.array([True]))
    stored = json.loads((REPOSITORY / "results/keycld/fast/pendulum-keycld-0.json").read_text())
    next(iter(stored["curves"].values()))["low"].pop()
    with pytest.raises(Unexpected, match="same length"):
        checked(stored, Result)
    stored["curves"] = {}
    next(iter(stored["scores"].values()))["baselines"]["mean image"].pop("1")
    with pytest.raises(Unexpected, match=r"baselines.mean image.1' is missing"):
        checked(stored, Result)


def _is_checked(value, kind):
    try:
        return checked(value, kind) == value
    except Unexpected:
        return False


def test_states_that_their_renderer_cannot_render_are_refused(tmp_path):
    from keycld.data import make_data, open_data

    small = dict.fromkeys(("train", "test", "test_long"), 3)
    made = make_data("toy/pendulum", tmp_path / "a", runs={"train": 2, "test": 1}, frames=small)
    with h5py.File(made.folder / "train.h5", "r+") as file:
        del file["parameters/offset"]
    with pytest.raises(KeycldError, match="are not those from which their pictures are rendered"):
        open_data(made.folder).split("train")


def test_a_picture_that_claims_too_many_pixels_is_refused(tmp_path):
    """A few bytes, whose header says 60,000 × 60,000."""

    def chunk(kind, data=b""):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 60_000, 60_000, 1, 0, 0, 0, 0)
    (tmp_path / "bomb.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT"))
    with pytest.raises(KeycldError, match="pixels"):
        load_image(tmp_path / "bomb.png")


@pytest.mark.parametrize("address", ["http:/127.0.0.1:9/a.mp4", "pipe:0", "concat:a|b"])
def test_a_video_is_a_file(address, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(KeycldError, match="there is no video"):
        import_video(address, "out")


def test_a_playlist_opens_no_other_file(tmp_path):
    save_movie(tmp_path / "a.mp4", NOISE, scale=1)
    (tmp_path / "list.mp4").write_text("#EXTM3U\n#EXTINF:1,\na.mp4\n#EXT-X-ENDLIST\n")
    (tmp_path / "more.mp4").write_text("ffconcat version 1.0\nfile a.mp4\n")
    for name in ("list.mp4", "more.mp4"):
        with pytest.raises(KeycldError, match="cannot be read as a video"):
            import_video(tmp_path / name, tmp_path / "out", frames=5)


def test_text_in_a_page_is_escaped():
    assert "<" not in html.text("<script>\x1b") and "\x1b" not in html.text("\x1b")


def test_an_unforeseen_error_is_one_sentence(monkeypatch, capsys, tmp_path):
    import keycld.data

    def breaks(path):
        raise ZeroDivisionError("a\nb")

    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr(keycld.data, "check", breaks)
    assert main(["data", "check", "x"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("keycld: ZeroDivisionError (a)") and said.count("\n") == 1
    [log] = tmp_path.glob("keycld-*.log")
    assert "Traceback" in log.read_text()
    assert main(["data", "check", "x", "--debug"]) == 2 and "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("pause", [0.0, 0.8, 2.6])
def test_a_signal_ends_the_command_without_a_traceback(tmp_path, number, code, pause):
    # A shell's background job ignores interrupts, and so would these tests in one.
    command = ["env", "--default-signal=INT", Path(sys.executable).parent / "keycld"]
    command += ["data", "make", "toy/pendulum", "--out", "data"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    # Before the first line of ours Python itself ends, as every program: on a busy machine that takes seconds.
    while not _handles(process.pid, signal.SIGTERM):
        assert process.poll() is None
        time.sleep(0.01)
    time.sleep(pause)
    process.send_signal(number)
    _, said = process.communicate(timeout=20)
    assert "Traceback" not in said and "ed; the same command continues." in said
    assert process.returncode == code


def test_only_verbs_that_resume_promise_it_after_a_signal():
    for words in (["train", "x"], ["--debug", "bench", "run", "keycld"], ["data", "make", "pendulum"]):
        assert after_an_end(words) == "the same command continues"
    for words in (["predict", "pendulum", "--data", "train"], ["data", "import", "a.mp4"], ["bench", "table"], []):
        assert after_an_end(words) == "run it again"


def _handles(pid, number):
    """Whether a process has a handler for a signal, by the kernel's word."""
    status = Path(f"/proc/{pid}/status").read_text()
    [caught] = (line.split()[1] for line in status.splitlines() if line.startswith("SigCgt:"))
    return int(caught, 16) >> (number - 1) & 1 == 1


@pytest.mark.parametrize("moment", range(1, 8))
def test_a_kill_at_a_write_leaves_the_old_file_or_the_new_one(tmp_path, moment):
    """The process dies before the n-th call of the operating system that changes files."""
    (tmp_path / "a.txt").write_text("old")
    code = (
        "import os, shutil, sys, pathlib\n"
        "from keycld import _files\n"
        "left = int(sys.argv[2])\n"
        "def dies(event, arguments):\n"
        "    global left\n"
        "    if event in ('os.mkdir', 'os.rename', 'os.remove', 'os.rmdir', 'shutil.rmtree')"
        " or event == 'open' and arguments[2] & (os.O_WRONLY | os.O_RDWR):\n"
        "        left -= 1\n"
        "        if left == 0: os.kill(os.getpid(), 9)\n"
        "sys.addaudithook(dies)\n"
        "_files.write_text(pathlib.Path(sys.argv[1]), 'new')\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.txt"), str(moment)], check=False)
    assert (tmp_path / "a.txt").read_text() in ("old", "new")
    write_text(tmp_path / "a.txt", "newer")
    assert os.listdir(tmp_path) == ["a.txt"]


def test_damaged_files_give_one_sentence(tmp_path, monkeypatch, capsys):
    """A small, fixed part of the campaign's cases."""
    monkeypatch.syspath_prepend(str(REPOSITORY))
    from validation.faults.mutate import damage

    folder = tmp_path / "data"
    for seed in range(60):
        name = ("train.h5", "statistics.json")[seed % 2]
        for split in ("train", "validation"):
            if (folder / f"{split}.h5").is_dir():
                (folder / f"{split}.h5").rmdir()
            write(folder / f"{split}.h5", sample())
        if (folder / "statistics.json").is_dir():
            (folder / "statistics.json").rmdir()
        split = {"trajectories": 3, "frames": 5, "bytes": 1, "sha256": "0"}
        (folder / "statistics.json").write_text(json.dumps({"splits": {"train": split}}))
        done = damage(folder / name, seed)
        code = main(["data", "check", str(folder)])
        said = capsys.readouterr().err
        assert code in (0, 2) and "did not foresee" not in said, (seed, done, said)
        assert (code == 2) == ("keycld: " in said)


def test_a_folder_in_place_of_a_file_to_predict(tmp_path, capsys):
    assert main(["predict", "pendulum", "--data", str(tmp_path), "--out", str(tmp_path / "out.h5")]) == 2
    assert f"{tmp_path} is a folder: name a file in it, such as" in capsys.readouterr().err


def test_a_second_process_waits_for_the_lock(tmp_path):
    from keycld._lock import alone

    with alone(tmp_path), (tmp_path / ".lock").open() as file, pytest.raises(BlockingIOError):
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_the_bill_of_materials_has_every_pinned_package():
    lock = (REPOSITORY / "requirements.lock").read_text()
    parts = runpy.run_path(str(REPOSITORY / "scripts" / "bill_of_materials.py"))["bill"](lock)["components"]
    pinned = [line.split(" ")[0] for line in lock.splitlines() if "==" in line and not line.startswith(("#", " "))]
    assert [f"{part['name']}=={part['version']}" for part in parts] == pinned
    assert sum(len(part["externalReferences"]) for part in parts) == lock.count("--hash=sha256:")
    assert "index-url http" not in lock


def test_a_lock_on_a_full_disk_is_one_sentence(tmp_path):
    from keycld._lock import alone

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        with pytest.raises(KeycldError, match="larger than"), alone(tmp_path):
            pass
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
