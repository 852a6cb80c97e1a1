"""Compile csstsim's functions for the processors of most machines, for the wheel: nothing is compiled where it fits.

    python builders/build_kernels.py FOLDER

Runs what `csstsim doctor --warm` runs, with numba compiling for csstsim.base.process.shipped_kernels.PROCESSOR, and
stores the code of each function under the content of its sources. `make wheel` puts the folder into the package. A
trial without a wheel: CSSTSIM_KERNELS=FOLDER csstsim chip ...
"""

import argparse
import gc
import json
import os
import sys
import tempfile
from pathlib import Path

from csstsim.base.process.reached_sources import sources_digest
from csstsim.base.process.shipped_kernels import ABOUT, FEATURES, PROCESSOR, VARIABLE, shipped_folder, versions


def compile_all(folder: Path) -> int:
    """Fill a folder with the code of all functions that `doctor --warm` compiles; return their number.

    The process must not have loaded numba, which reads its settings once.
    """
    with tempfile.TemporaryDirectory() as cache:
        os.environ |= {"NUMBA_CACHE_DIR": cache, "NUMBA_CPU_NAME": PROCESSOR, "NUMBA_CPU_FEATURES": "", VARIABLE: ""}
        from csstsim.stages.warm import warm

        warm()
        return store(folder)


def store(folder: Path) -> int:
    """Write the code of the functions that this process has compiled, and what it fits; return their number."""
    from numba.core.caching import IndexDataCacheFile
    from numba.core.dispatcher import Dispatcher
    from numba.core.registry import cpu_target

    count = 0
    for function in gc.get_objects():
        file = isinstance(function, Dispatcher) and getattr(function._cache, "_cache_file", None)
        if not hasattr(file, "shipped"):  # never called
            continue
        source = function.py_func.__code__.co_filename
        target = shipped_folder(source, str(folder))
        if target is None:
            continue
        Path(target).mkdir(parents=True, exist_ok=True)
        stored = IndexDataCacheFile(target, function._cache._impl.filename_base, sources_digest(source))
        for key, name in file._load_index().items():
            stored.save(key, file._load_data(name))
        count += 1
    target = cpu_target.target_context.codegen().magic_tuple()
    about = {"versions": versions(), "features": FEATURES, "target": target, "functions": count}
    (folder / ABOUT).write_text(json.dumps(about, indent=1))
    return count


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="new or empty")
    folder = parser.parse_args().folder
    if folder.exists() and any(folder.iterdir()):
        sys.exit(f"{folder}: is not empty")
    print(f"{folder}: {compile_all(folder)} functions")
