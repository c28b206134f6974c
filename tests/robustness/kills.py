"""Kill `scan3d reconstruct` again and again while it writes into one folder, and read the folder after each kill.

    python tests/robustness/kills.py --kills 100

Two recordings are reconstructed in turn into the same folder.  A run is killed (SIGKILL) at a random moment: a third of them
anywhere between its start and its end, a third while it writes, a third while it moves the new files over the old ones.  After
each kill the folder must hold the whole result of one of the two recordings, as the program reads it, and nothing of the
other; at the end a run that is left alone must succeed.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[2]
MESHES = ROOT / "meshes"
# What appears when a run begins to write, and when all files are written and are about to be moved, which takes about so many
# seconds.
WORK, COMPLETE = ".scan3d-work-*", ".scan3d-complete"
_MOVING_S = 0.003
SCAN = ("--slices", "4", "--sweeps", "4", "--samples", "8", "--quiet")
# Without a display this class of VTK's windows can't be opened, and there are no pictures.
_NO_PICTURES = {"VTK_DEFAULT_OPENGL_WINDOW": "vtkXOpenGLRenderWindow"}


def kills(number: int, place: Path, *, seed: int = 0, pictures: bool = False) -> Counter[str]:
    """Kill that many runs; returns how often the folder held the earlier and the new result, and how many runs had ended.

    Raises AssertionError if a folder is mixed, torn or lost.
    """
    draw, environment = random.Random(seed), _environment(pictures)
    recordings = [place / f"{name}.csv" for name in ("cube", "egg")]
    expected, seconds, seconds_writing = {}, 0.0, 0.0
    for recording in recordings:
        _call(environment, "simulate", MESHES / f"{recording.stem}.stl", "--out", recording, *SCAN)
        start = time.monotonic()
        child = _start(environment, "reconstruct", recording, "--out", place / recording.stem, "--quiet")
        _wait_for(child, place / recording.stem, WORK)
        writing = time.monotonic()
        assert child.wait() == 0
        seconds, seconds_writing = time.monotonic() - start, time.monotonic() - writing
        expected[recording] = _files(place / recording.stem)
    folder, counts = place / "out", Counter[str]()
    _call(environment, "reconstruct", recordings[1], "--out", folder, "--quiet")
    held = recordings[1]
    for k in range(number):
        recording = recordings[k % 2]
        child = _start(environment, "reconstruct", recording, "--out", folder, "--quiet")
        when = draw.choice(["any time", "writing", "moving"])
        if when == "any time":
            _wait(child, seconds * draw.random())
        else:
            _wait_for(child, folder, WORK if when == "writing" else COMPLETE)
            _wait(child, (seconds_writing if when == "writing" else _MOVING_S) * draw.random())
        counts["ended before"] += child.poll() is not None
        child.kill()
        child.wait()
        found = _files(folder)
        matches = [path for path, files in expected.items() if files == found]
        assert matches, f"after kill {k + 1} the folder holds {sorted(found)}, of no single run"
        counts["new result" if matches[0] == recording and held != recording else "earlier result"] += 1
        held = matches[0]
    _call(environment, "reconstruct", recordings[0], "--out", folder, "--quiet")
    assert _files(folder) == expected[recordings[0]]
    assert not list(folder.glob(".scan3d-*"))
    return counts


def _files(folder: Path) -> dict[str, str]:
    """The hashes of the files in a folder but the report, after the program has read it without complaint."""
    from scan3d.files.whole import read_report
    from scan3d.scenes import read_folder

    _, report = read_folder(folder, "mm")
    names = {path.name for path in folder.iterdir() if path.is_file()}
    assert names == set(report["files"]), f"{sorted(names)} where the report names {sorted(report['files'])}"
    files = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names - {"report.json"}}
    assert files == read_report(folder)["sha256"]
    return files


def _environment(pictures: bool) -> dict[str, str]:
    import os

    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", **({} if pictures else _NO_PICTURES)}


def _start(environment: dict[str, str], *arguments: object) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "scan3d", *map(str, arguments)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _call(environment: dict[str, str], *arguments: object) -> None:
    assert _start(environment, *arguments).wait() == 0, arguments


def _wait(child: subprocess.Popen[bytes], seconds: float) -> None:
    end = time.monotonic() + seconds
    while child.poll() is None and time.monotonic() < end:
        time.sleep(0.001)


def _wait_for(child: subprocess.Popen[bytes], folder: Path, pattern: str) -> None:
    while child.poll() is None and not any(folder.glob(pattern)):
        time.sleep(0.0002)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100, help="number of kills (default 100)")
    parser.add_argument("--seed", type=int, default=0, help="of the moments (default 0)")
    parser.add_argument("--pictures", action="store_true", help="with pictures, where they can be rendered")
    arguments = parser.parse_args()
    with TemporaryDirectory() as place:
        counts = kills(arguments.kills, Path(place), seed=arguments.seed, pictures=arguments.pictures)
    print(f"{arguments.kills} kills: " + ", ".join(f"{count} {what}" for what, count in sorted(counts.items())))


if __name__ == "__main__":
    main()
