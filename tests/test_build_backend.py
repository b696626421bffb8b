"""The build backend: which compiler it takes, and when it asks pip for one."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("scikit_build_core")
CHECKOUT = Path(__file__).parents[1]
HOOK = "import pinconsist_build as b; print(b.get_requires_for_build_{}({}))"


def required(kind="wheel", settings=None, **environment):
    """What the backend asks for, and what it says."""
    done = subprocess.run(
        [sys.executable, "-c", HOOK.format(kind, settings)],
        cwd=CHECKOUT,
        env={"PATH": os.environ["PATH"], "PYTHONPATH": str(CHECKOUT / "build_backend"), **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout, done.stderr


def executable(path, text):
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


@pytest.mark.parametrize("kind", ["wheel", "editable"])
def test_ziglang_is_asked_for_without_a_compiler(kind):
    asked, said = required(kind, CXX="/no/compiler")
    assert "ziglang" in asked
    assert "CXX=/no/compiler compiles no C++17: pip gets one, ziglang" in said


def test_ziglang_is_asked_for_where_the_path_has_no_compiler(tmp_path):
    asked, said = required(PATH=str(tmp_path))
    assert "ziglang" in asked and "there is no C++17 compiler" in said


@pytest.mark.skipif(not shutil.which("c++"), reason="needs a C++ compiler")
def test_a_compiler_of_the_machine_is_taken(tmp_path):
    assert "ziglang" not in required()[0]
    broken = executable(tmp_path / "c++", "exit 1")  # as the stub of macOS without its command line tools
    works = executable(tmp_path / "g++", f'exec {shutil.which("c++")} "$@"')
    assert "ziglang" not in required(PATH=f"{tmp_path}:{os.environ['PATH']}")[0]
    assert "ziglang" in required(CXX=broken)[0]
    assert "ziglang" not in required(CXX=f"{works} -O1")[0]


def test_an_older_compiler_counts_as_none(tmp_path):
    old = executable(tmp_path / "c++", 'case "$*" in *std=c++17*) exit 1;; esac')
    assert "ziglang" in required(CXX=old)[0]


@pytest.mark.parametrize(
    ("settings", "environment"),
    [
        ({"cmake.define.CMAKE_CXX_COMPILER": "/own"}, {}),
        ({}, {"CMAKE_ARGS": "-DCMAKE_CXX_COMPILER=/own"}),
        ({}, {"CMAKE_TOOLCHAIN_FILE": "own.cmake"}),
    ],
)
def test_who_tells_cmake_its_compiler_is_not_overruled(settings, environment):
    assert "ziglang" not in required(settings=settings, CXX="/no/compiler", **environment)[0]


def test_a_launcher_is_not_a_compiler():
    assert "ziglang" in required(CXX="/no/compiler", CMAKE_ARGS="-DCMAKE_CXX_COMPILER_LAUNCHER=ccache")[0]
