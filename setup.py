"""Builds the two extension modules with cargo; the rest is in pyproject.toml.

``_native`` needs Rust alone. ``_models`` is linked with libtorch: that of LIBTORCH, of the link
.libtorch that `make setup` makes, or of the torch that pip installs for the time of the build.
``CCDIFF_MODELS=0`` leaves it out, and with it gigabytes of torch.
"""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

HERE = Path(__file__).resolve().parent
TORCH = re.search(r"torch==[\d.]+", (HERE / "pyproject.toml").read_text(encoding="utf-8"))[0]
#: Extension modules and the crates that they are.
CRATES = {"ccdiff_env._native": "ccdiff-py", "ccdiff_env._models": "ccdiff-py-models"}
if os.environ.get("CCDIFF_MODELS") == "0":
    del CRATES["ccdiff_env._models"]


def libtorch() -> Path | None:
    """Return the folder of libtorch that was named, if there is one."""
    named = os.environ.get("LIBTORCH")
    folder = Path(named) if named else HERE / ".libtorch"
    return folder if named or folder.exists() else None


class Cargo(build_ext):
    """One call of cargo for both modules, so that both get the same build of what they share."""

    def run(self) -> None:
        """Compile, then copy."""
        if self.extensions:
            self._compile()
        super().run()

    def _compile(self) -> None:
        environment = dict(os.environ)
        for tool, cure in (("cargo", "install Rust, https://rustup.rs"), ("c++", "install g++")):
            if shutil.which(tool) is None:
                sys.exit(f"ccdiff-env: building needs {tool}, which is not there: {cure}")
        if "ccdiff_env._models" in CRATES:
            folder, spec = libtorch(), find_spec("torch")
            if folder is None and spec is not None:
                folder = Path(spec.origin).parent
            if folder is None or not (folder / "include").is_dir():
                sys.exit(
                    f"ccdiff-env: networks are built with {TORCH}, which is not "
                    f"{'there' if folder is None else f'in {folder}'}: pip install {TORCH}, or "
                    "leave networks out with CCDIFF_MODELS=0"
                )
            # the link is where .cargo/config.toml looks, too: one spelling, one build
            if folder != HERE / ".libtorch":
                environment["LIBTORCH"] = str(folder)
        packages = [word for crate in CRATES.values() for word in ("-p", crate)]
        call = ["cargo", "build", "--release", "--locked", *packages]
        if subprocess.run(call, cwd=HERE, env=environment, check=False).returncode != 0:
            sys.exit(f"ccdiff-env: {' '.join(call)} failed, see above")

    def build_extension(self, ext: Extension) -> None:
        """Copy what cargo made."""
        target = Path(os.environ.get("CARGO_TARGET_DIR", HERE / "target")) / "release"
        path = Path(self.get_ext_fullpath(ext.name))
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(target / f"lib{ext.name.rpartition('.')[2]}.so", path)


setup(
    ext_modules=[Extension(name, [], py_limited_api=True) for name in CRATES],
    cmdclass={"build_ext": Cargo},
    options={"bdist_wheel": {"py_limited_api": "cp310"}},
    # asked for by pip before it builds: only where nobody says where libtorch is
    setup_requires=[TORCH] if len(CRATES) == 2 and libtorch() is None else [],
)
