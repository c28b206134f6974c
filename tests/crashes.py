"""Crash injection: an action runs in a forked child process, which ends at its k-th call of the file system, for every k.

The calls are found by Python's audit events, which precede everything that opens, renames, removes or makes a file or a folder,
and by replacing what has no event: flushing, writing into an open file, and the middle of writing a file's contents.
"""

import errno
import os
import sys
from pathlib import Path

_EVENTS = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate", "os.listdir", "os.scandir"}
# What fails on a full disk; names can still be removed and renamed.
_NEEDS_SPACE = {"open", "os.mkdir", "write", "half", "fsync"}
_KILLED = 77


class _Faults:
    """Counts the calls, and acts at one of them."""

    def __init__(self, act, kth):
        self.act, self.kth, self.count = act, kth, 0

    def __call__(self, event, path):
        if event == "open" and isinstance(path, (str, bytes)) and os.fsdecode(path).endswith((".py", ".pyc")):
            return
        self.count += 1
        self.act(event, self.count, self.kth)


def _kill(event, count, kth):
    if count == kth:
        os._exit(_KILLED)


def _interrupt(event, count, kth):
    if count == kth:
        raise KeyboardInterrupt


def _fill_disk(event, count, kth):
    if count >= kth and event in _NEEDS_SPACE:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


ACTS = {"kill": _kill, "ctrl-c": _interrupt, "full disk": _fill_disk}


def _install(faults):
    fsync, write = os.fsync, os.write

    def watched(event, arguments):
        if event == "open" and not _opens_for_writing(arguments):
            return
        if event in _EVENTS:
            faults(event, arguments[0])

    def flushed(handle):
        faults("fsync", None)
        fsync(handle)

    def written(handle, data):
        faults("write", None)
        return write(handle, data)

    def write_bytes(path, data):
        with open(path, "wb") as file:
            file.write(data[: len(data) // 2])
            file.flush()
            faults("half", path)
            file.write(data[len(data) // 2 :])

    os.fsync, os.write = flushed, written
    Path.write_bytes = write_bytes
    Path.write_text = lambda path, text, **_: path.write_bytes(text.encode())
    sys.addaudithook(watched)


def _opens_for_writing(arguments):
    _, mode, flags = arguments
    return bool(set(mode or "") & set("wax+")) if mode else bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))


def run(action, how, kth):
    """Run the action in a child process with the kth call failing: True if it came to its end before that call.

    The child ends with the exit code of the fault, and nothing of it remains but its files.
    """
    child = os.fork()
    if child == 0:
        code = 1
        try:
            faults = _Faults(ACTS[how], kth)
            _install(faults)
            try:
                action()
            except BaseException:
                code = 2
            else:
                code = 0 if faults.count < kth else 3
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    assert code in (0, 2, 3, _KILLED), f"the child process ended with {code}"
    return code == 0


def every(action, how, prepare, check, step=1):
    """For k = 1, 1 + step, …: prepare, run the action with a fault at its kth call, and check; returns the number of calls."""
    kth = 1 - step
    ended = False
    while not ended:
        kth += step
        prepare()
        ended = run(action, how, kth)
        check(kth, ended)
        assert kth < 2000
    return kth - 1
