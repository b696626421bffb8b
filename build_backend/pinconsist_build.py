"""The build backend of pinconsist: scikit-build-core, with the compiler of ziglang where there is no other.

``pip install .`` compiles C++17. Where neither ``CXX`` nor a usual name is a compiler that can, pip is asked for the
package ziglang, which holds Clang and a C++ library, and CMake is told to use it.
"""

import contextlib
import os
import platform
import re
import shlex
import shutil
import stat
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

from scikit_build_core import build as scikit
from scikit_build_core.build import *  # noqa: F403

ZIGLANG = "ziglang>=0.17"
WRAPPERS = Path("build/zig").absolute()  # CMake remembers where its compiler is
OLDEST_GLIBC = "2.28"  # that of Pinocchio's wheels
NAMES = ("c++", "g++", "clang++", "icpx")  # CMake's choice and, if that does not work, others
PROGRAM = """
#include <optional>
int main(int arguments, char **) {
  if constexpr (sizeof(void *) > 0) return std::optional<int>(arguments).value() - 1;
}
"""


def _chosen_by_user(config_settings):
    """Whether the user tells CMake itself what compiles."""
    told = f"{os.environ.get('CMAKE_ARGS', '')} {config_settings or ''}"
    return "CMAKE_TOOLCHAIN_FILE" in os.environ or re.search(r"CMAKE_CXX_COMPILER(?!_)|toolchain", told, re.IGNORECASE)


def _works(command):
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "program.cpp")
        source.write_text(PROGRAM)
        program = Path(folder, "program")
        try:
            compiled = subprocess.run(
                [*command, "-std=c++17", str(source), "-o", str(program)], capture_output=True, timeout=120
            )
        except (OSError, subprocess.TimeoutExpired):
            return False
        return compiled.returncode == 0 and program.is_file()


def _compiler():
    """The command of a C++17 compiler, as in CXX, or None."""
    if "CXX" in os.environ:
        candidates = [os.environ["CXX"]]
    else:
        of_python = [word for word in shlex.split(sysconfig.get_config_var("CXX") or "") if not word.startswith("-")]
        candidates = [shlex.join(of_python), *NAMES]
    for candidate in candidates:
        if candidate.strip() and _works(shlex.split(candidate)):
            return candidate
    return None


def _missing():
    if "CXX" in os.environ:
        return f"CXX={os.environ['CXX']} compiles no C++17"
    return "there is no C++17 compiler"


def _say(text):
    print(f"pinconsist: {text}", file=sys.stderr, flush=True)


def _requires_ziglang(config_settings):
    if _chosen_by_user(config_settings) or _compiler():
        return []
    _say(f"{_missing()}: pip gets one, {ZIGLANG}, for this build (100 MB)")
    return [ZIGLANG]


def get_requires_for_build_wheel(config_settings=None):
    return scikit.get_requires_for_build_wheel(config_settings) + _requires_ziglang(config_settings)


def get_requires_for_build_editable(config_settings=None):
    return scikit.get_requires_for_build_editable(config_settings) + _requires_ziglang(config_settings)


def _zig():
    """The compiler of the package ziglang."""
    try:
        import ziglang
    except ImportError:
        raise SystemExit(
            f"pinconsist: {_missing()}, and the package ziglang is not there. Install a compiler, for example by "
            f"'apt install g++', or run 'pip install {shlex.quote(ZIGLANG)}', and try again."
        ) from None
    return Path(ziglang.__file__).with_name("zig")


def _target():
    """Options for any processor of this kind and any system that Pinocchio has wheels for."""
    if sys.platform == "linux" and platform.libc_ver()[0] == "glibc":
        return f"-target {platform.machine()}-linux-gnu.{OLDEST_GLIBC}"
    return "-mcpu=baseline"


def _write_wrappers(zig):
    WRAPPERS.mkdir(parents=True, exist_ok=True)
    # Its C++ library is compiled once for each level of optimisation; CMake's first programs have none of their own.
    for name, options in (("c++", f"{_target()} -g0 -O3"), ("ar", ""), ("ranlib", "")):
        script = WRAPPERS / name
        script.write_text(f'#!/bin/sh\nexec {shlex.quote(str(zig))} {name} {options} "$@"\n')
        script.chmod(script.stat().st_mode | stat.S_IXUSR | stat.S_IXGRP | stat.S_IXOTH)


@contextlib.contextmanager
def _environment(**variables):
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


@contextlib.contextmanager
def _with_compiler(config_settings):
    """CMake's environment, with a compiler."""
    if _chosen_by_user(config_settings):
        yield
        return
    compiler = _compiler()
    if compiler:
        with _environment(CXX=compiler):
            yield
        return
    _write_wrappers(_zig())
    cache = tempfile.mkdtemp(prefix="pinconsist-zig-")
    arguments = f"{os.environ.get('CMAKE_ARGS', '')} -DCMAKE_AR={WRAPPERS}/ar -DCMAKE_RANLIB={WRAPPERS}/ranlib"
    caches = {name: os.environ.get(name, cache) for name in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")}
    try:
        with _environment(CXX=f"{WRAPPERS}/c++", CMAKE_ARGS=arguments.strip(), **caches):
            yield
    finally:
        shutil.rmtree(cache, ignore_errors=True)
    _say(f"{_missing()}: compiled by {ZIGLANG.partition('>')[0]} instead")


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    with _with_compiler(config_settings):
        return scikit.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_editable(wheel_directory, config_settings=None, metadata_directory=None):
    with _with_compiler(config_settings):
        return scikit.build_editable(wheel_directory, config_settings, metadata_directory)
