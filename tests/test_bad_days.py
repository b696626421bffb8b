"""What goes wrong around a run: full disks, missing permission, signals, other people's functions. Nothing is lost."""

from __future__ import annotations

import errno
import logging
import os
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import pinconsist as pc
from pinconsist.engine import required
from pinconsist.files import written_whole

ROOT = Path(pc.__file__).resolve().parents[1]
PROGRAM = [sys.executable, "-m", "pinconsist.cli"]
UNHURRIED = """
import sys, time
time.monotonic = lambda: 0.0  # a stop watch that stands: no checkpoint is passed over
from pinconsist.cli import main
sys.exit(main())
"""


def command(*arguments, **options):
    """Exit code, stdout and stderr of the program in a process of its own."""
    done = subprocess.run(
        [*options.pop("before", ()), *options.pop("program", PROGRAM), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        **options,
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done.returncode, done.stdout, done.stderr


def small_files():
    """No file of this process grows beyond 60 kB: for a program the same as a disk that is full."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))


@pytest.fixture
def unprivileged():
    """What makes a command obey permissions although the tests run as root."""
    if os.geteuid():
        return ()
    if not shutil.which("setpriv"):
        pytest.skip("root obeys no permissions, and there is no setpriv to give them up")
    return ("setpriv", "--bounding-set=-all", "--inh-caps=-all")


def rescued(text):
    """The solution that a message says was saved elsewhere."""
    file = Path(re.search(r"saved as (\S+\.npz) instead", text)[1])
    sol = pc.Solution.load(file)
    again = pc.rerun(file)
    file.unlink()
    assert again.same
    return sol


def full(stream, **arrays):
    stream.write(b"half")
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_disk_that_is_full_at_the_end_loses_no_run(tmp_path, monkeypatch):
    pc.record("four_bar", (0.0, 0.1), tmp_path / "run")
    before = (tmp_path / "run.npz").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        with pytest.raises(pc.SavingError, match=r"run.npz cannot be written: No space left on device") as caught:
            pc.record("four_bar", (0.0, 0.2), tmp_path / "run")
    assert caught.value.solution.success and caught.value.solution.t[-1] == 0.2
    assert (tmp_path / "run.npz").read_bytes() == before and len(list(tmp_path.iterdir())) == 1
    assert pc.rerun(caught.value.solution.save(tmp_path / "other")).same


def test_a_disk_that_is_full_for_a_while_is_tried_again(tmp_path, monkeypatch, caplog):
    save, tries = np.savez, []

    def sometimes(stream, **arrays):
        tries.append(len(arrays["t"]))
        (full if len(tries) in (2, 3) else save)(stream, **arrays)

    monkeypatch.setattr(np, "savez", sometimes)
    monkeypatch.setattr("time.monotonic", lambda: 0.0)  # a stop watch that stands: no checkpoint is passed over
    with caplog.at_level(logging.WARNING, "pinconsist"):
        sol = pc.record("four_bar", (0.0, 0.5), tmp_path / "run", save_every=0.1)
    assert sol.success and len(tries) == 5 and len(caplog.records) == 2
    assert "No space left on device, at t = 0.2; the run continues" in caplog.messages[0]
    assert pc.rerun(tmp_path / "run.npz").same


def test_the_command_saves_elsewhere_where_a_disk_is_full(tmp_path):
    """/dev/full is a real device that is full; a mount point of its own would need root."""
    code, _, err = command("simulate", "four_bar", "--until", 1, "--html", "/dev/full", cwd=tmp_path)
    assert code == 2 and "error: /dev/full cannot be written: No space left on device; the run is saved as" in err
    assert rescued(err).t[-1] == 1.0 and not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_command_that_can_save_nowhere_says_so(tmp_path):
    code, _, err = command(
        "simulate",
        "four_bar",
        "--until",
        20,
        "--save-every",
        0.2,
        "--out",
        "run.npz",
        cwd=tmp_path,
        preexec_fn=small_files,
        program=[sys.executable, "-c", UNHURRIED],
    )
    assert code == 2 and "warning: run.npz cannot be written: File too large, at t = " in err
    assert "run.npz cannot be written: File too large; the run is lost: no other folder is writable" in err
    assert pc.Solution.load(tmp_path / "run.npz").t[-1] > 0.1  # the last checkpoint that fitted
    assert pc.resume(tmp_path / "run.npz").t[-1] == 20.0 and len(list(tmp_path.iterdir())) == 1


@pytest.mark.slow
def test_a_stdout_that_breaks_off_takes_no_run_along(tmp_path):
    for stdout, message in (("/dev/full", "cannot print: No space left on device; files are written"), (None, "")):
        reader, writer = os.pipe() if stdout is None else (None, os.open(stdout, os.O_WRONLY))
        if reader is not None:
            os.close(reader)  # as head does
        done = subprocess.run(
            [*PROGRAM, "simulate", "four_bar", "--until", "0.2", "--out", "run.npz"], stdout=writer,
            stderr=subprocess.PIPE, text=True, cwd=tmp_path, env=os.environ | {"PYTHONUNBUFFERED": "1"}, check=False,
        )  # fmt: skip
        os.close(writer)
        assert done.returncode == 1 and message in done.stderr and "Traceback" not in done.stderr
        assert pc.Solution.load(tmp_path / "run.npz").success
        (tmp_path / "run.npz").unlink()


def test_devices_and_pipes_are_written_into_and_stay(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with written_whole(pipe) as stream:
        stream.write(b"content")
    assert os.read(reader, 100) == b"content" and pipe.is_fifo() and len(list(tmp_path.iterdir())) == 1
    os.close(reader)
    with pytest.raises(OSError, match="No space left"), written_whole("/dev/full") as stream:
        stream.write(b"content")
    assert Path("/dev/full").is_char_device()


def test_a_folder_that_is_not_there_is_said_with_the_name_of_the_file(tmp_path):
    file = tmp_path / "none" / "map.csv"
    with pytest.raises(FileNotFoundError, match=r"there is no folder for: '.*none.map.csv'"), written_whole(file):
        pass


def test_after_a_power_cut_there_is_the_old_file_or_the_new_one(tmp_path, monkeypatch):
    """First the content is on the disk, then the name, then the folder that has the name."""
    done, sync, replace = [], os.fsync, os.replace

    def noted(number):
        done.append(os.path.realpath(f"/proc/self/fd/{number}"))
        sync(number)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(os, "replace", lambda *names: (done.append("replace"), replace(*names)))
    with written_whole(tmp_path / "file") as stream:
        stream.write(b"content")
    assert done[1:] == ["replace", str(tmp_path.resolve())] and Path(done[0]).parent == tmp_path.resolve()

    def folders_cannot(number):
        if os.path.isdir(f"/proc/self/fd/{number}"):
            raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(os, "fsync", folders_cannot)  # as on some network file systems
    with written_whole(tmp_path / "file") as stream:
        stream.write(b"other")
    assert (tmp_path / "file").read_bytes() == b"other"


@pytest.mark.slow
def test_no_permission(tmp_path, unprivileged):
    locked, file = tmp_path / "locked", tmp_path / "secret.npz"
    locked.mkdir(mode=0o555)
    file.touch(mode=0o000)
    before = {"before": unprivileged, "cwd": tmp_path}
    code, _, err = command("simulate", "four_bar", "--out", "locked/run.npz", **before)
    assert code == 2 and re.search(
        r"error: locked/run.npz cannot be written: no permission to write in .*locked\n", err
    )
    code, _, err = command("rerun", "secret.npz", **before)
    assert code == 2 and "error: secret.npz: cannot be read: Permission denied" in err


@pytest.mark.slow
def test_permission_that_is_taken_away_during_the_run(tmp_path, unprivileged):
    folder = tmp_path / "fading"
    folder.mkdir()
    arguments = ["simulate", "four_bar", "--until", "300", "--out", "fading/run.npz", "--save-every", "5"]
    process = subprocess.Popen([*unprivileged, *PROGRAM, *arguments], cwd=tmp_path, stderr=subprocess.PIPE, text=True,
                               stdout=subprocess.DEVNULL)  # fmt: skip
    while process.poll() is None and not (folder / "run.npz").exists():
        time.sleep(0.001)
    folder.chmod(0o555)
    err = process.communicate(timeout=120)[1]
    folder.chmod(0o755)
    assert process.returncode == 2 and "fading/run.npz cannot be written: Permission denied; the run is saved as" in err
    assert rescued(err).t[-1] == 300.0 and pc.Solution.load(folder / "run.npz").t[-1] < 300


@pytest.mark.slow
def test_a_read_only_install_and_no_home(tmp_path, unprivileged):
    """Nothing is written beside the package, nor needed in a home folder."""
    install, home = tmp_path / "install", tmp_path / "home"
    for folder in ("pinconsist", "models"):
        shutil.copytree(ROOT / folder, install / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(required().__file__, install / "pinconsist" / "engine")
    # an editable install finds the checkout by a hook, before any path
    hook = "import sys\nsys.meta_path[:] = [x for x in sys.meta_path if 'Redirecting' not in type(x).__name__]\n"
    (install / "sitecustomize.py").write_text(hook)
    for path in (install, *install.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    home.mkdir(mode=0o555)
    work = tmp_path / "work"
    work.mkdir()
    env = os.environ | {"PYTHONPATH": str(install), "HOME": str(home)}
    code, out, err = command(
        "simulate", "four_bar", "--until", 0.2, "--out", "run.npz", "--html", "run.html", "--plot", "run.png",
        before=unprivileged, cwd=work, env=env,
    )  # fmt: skip
    assert code == 0 and "written: run.npz, run.html, run.png" in out, err
    assert command("rerun", "run.npz", before=unprivileged, cwd=work, env=env)[0] == 0
    where = [*unprivileged, sys.executable, "-c", "import pinconsist; print(pinconsist.__file__)"]
    options = {"env": env, "cwd": work}
    assert subprocess.run(where, **options, capture_output=True, text=True, check=True).stdout.startswith(str(install))
    assert not list(install.rglob("__pycache__")) and not list(home.iterdir())


@pytest.mark.parametrize("period", [None, 0.1])
def test_out_of_steps(tmp_path, period):
    sol = pc.record("four_bar", (0.0, 5.0), tmp_path / "run", max_steps=50, save_every=period, method="BDF")
    assert re.fullmatch(r"max_steps = 50 used up at t = 0\.\d+ of 5", sol.message)
    assert sol.nsteps == 50 == len(sol.h) and sol.status == -1 and pc.rerun(tmp_path / "run.npz").same


def after(end, error=RuntimeError):
    def law(t, q, v):
        if t > end:
            raise error("the sensor is gone")
        return np.array([0.5, 0.0, 0.0])

    return law


@pytest.mark.parametrize("period", [None, 0.2])
def test_a_force_that_raises_in_the_middle(tmp_path, period):
    sol = pc.record("four_bar", (0.0, 1.0), tmp_path / "run", forces=after(0.5), save_every=period)
    assert sol.status == -1 and 0.3 < sol.t[-1] <= 0.5
    assert "raised RuntimeError: the sensor is gone" in sol.message and "test_bad_days.py:" in sol.message
    kept = pc.Solution.load(tmp_path / "run.npz")
    assert np.array_equal(kept.t, sol.t) and kept.message == sol.message
    mended = pc.resume(tmp_path / "run.npz", forces=after(9.0))
    whole = pc.record("four_bar", (0.0, 1.0), tmp_path / "whole", forces=after(9.0), save_every=period)
    assert mended.success and np.array_equal(mended.q, whole.q)


def test_a_force_that_raises_where_a_stretch_begins(tmp_path):
    """The start of a stretch has no rows of its own that it could return."""
    sol = pc.record("four_bar", (0.0, 1.0), tmp_path / "run", forces=after(0.2), save_every=0.2)
    assert sol.status == -1 and sol.t[-1] == 0.2 and "the sensor is gone" in sol.message
    assert pc.Solution.load(tmp_path / "run.npz").message == sol.message


def test_ctrl_c_from_within_a_callback_is_an_interruption(tmp_path):
    def callback(t, q, v, lam):
        if t > 0.5:
            signal.raise_signal(signal.SIGTERM)

    sol = pc.record("four_bar", (0.0, 1.0), tmp_path / "run", callback=callback, save_every=0.2)
    assert sol.status == 1 and sol.message.startswith("interrupted at t = 0.5")
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert np.array_equal(
        pc.resume(tmp_path / "run.npz").q, pc.record("four_bar", (0, 1.0), tmp_path / "b", save_every=0.2).q
    )


def test_signals_of_the_application_stay_its_own(tmp_path):
    seen = []
    before = signal.signal(signal.SIGTERM, lambda *_: seen.append("own"))
    try:
        callback = lambda t, q, v, lam: seen or signal.raise_signal(signal.SIGTERM)  # noqa: E731
        sol = pc.record("four_bar", (0.0, 0.1), tmp_path / "run", callback=callback)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert seen == ["own"] and sol.status == 1


def test_two_viewers_at_once_have_a_port_each():
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 0.05))
    addresses = {pc.replay(mech, sol, open_browser=False) for _ in range(3)}
    assert len(addresses) == 3


def test_no_port_for_the_viewer_is_said(monkeypatch):
    def bind(self, address):
        raise OSError(errno.EADDRINUSE, "Address already in use")

    monkeypatch.setattr(socket.socket, "bind", bind)
    mech = pc.load("four_bar")
    with pytest.raises(
        pc.InputError, match=r"no page can be served on 127.0.0.1 here \(.*already in use\); write it by"
    ):
        pc.replay(mech, pc.simulate(mech, (0.0, 0.05)), open_browser=False)


def test_out_of_memory_keeps_what_was_saved(tmp_path, monkeypatch):
    """A stretch that finds no memory; which allocation fails first on a real machine nobody knows."""
    from pinconsist.run import checkpoints

    integrate, calls = checkpoints.integrate, []

    def hungry(*arguments, **options):
        calls.append(1)
        if len(calls) == 3:
            raise MemoryError
        return integrate(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(checkpoints, "integrate", hungry)
        sol = pc.record("four_bar", (0.0, 1.0), tmp_path / "run", save_every=0.2)
    assert (
        sol.status == -1 and sol.message.startswith("out of memory after t = 0.6") and sol.t[-1] == pytest.approx(0.6)
    )
    assert np.array_equal(
        pc.resume(tmp_path / "run.npz").q, pc.record("four_bar", (0, 1.0), tmp_path / "b", save_every=0.2).q
    )
