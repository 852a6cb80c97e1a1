"""The folder of the files that come with csstsim: the Snakefile, config/, examples/, profiles/, survey_tables/,
workflow/ and builders/build_distortion.py.

In a clone this is the repository. An installed package has copies in csstsim/_shipped.
"""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
_INSTALLED = _PACKAGE / "_shipped"
ROOT = _INSTALLED if _INSTALLED.is_dir() else _PACKAGE.parents[1]
SHIPPED = ROOT / "config"
