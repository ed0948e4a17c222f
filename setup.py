"""The part of the build that pyproject.toml cannot say: the loops over points are compiled where that is possible."""

from __future__ import annotations

import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel

# The limited API has had buffers since Python 3.11; from there on, one wheel serves every version.
ONE_FOR_ALL = sys.version_info >= (3, 11)

LOOPS = Path("src/pc2scan/core/loops")


class Wheel(bdist_wheel):
    """A wheel that is named after what is in it."""

    def run(self) -> None:
        """Compile first: without a compiler, the wheel is for every machine, for NumPy does the loops' work."""
        if not self.skip_build:
            self.run_command("build_ext")
            builder = self.get_finalized_command("build_ext")
            if not any(map(Path.exists, map(Path, builder.get_outputs()))):
                self.distribution.ext_modules = []
                self.root_is_pure, self.py_limited_api, self.plat_name_supplied = True, False, False
        super().run()


setup(
    ext_modules=[
        Extension(
            "pc2scan.core._kernel",
            sorted(map(Path.as_posix, LOOPS.glob("*.c"))),
            depends=sorted(map(Path.as_posix, LOOPS.glob("*.h"))),
            optional=True,
            py_limited_api=ONE_FOR_ALL,
            define_macros=[("Py_LIMITED_API", "0x030B0000")] if ONE_FOR_ALL else [],
            # -g0: debugging symbols would double the wheel. -ffp-contract=off: fusing a product into a sum would change
            # the last bit of results. The others change none.
            extra_compile_args=["-O3", "-g0", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"],
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}} if ONE_FOR_ALL else {},
    cmdclass={"bdist_wheel": Wheel},
)
