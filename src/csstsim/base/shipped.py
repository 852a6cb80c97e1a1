"""Where the files are that come with csstsim: the Snakefile, config/, examples/, profiles/, survey_tables/,
workflow/ and builders/build_distortion.py.

In a clone they are the repository's own; an installed package has copies of them, which its build took from there.
"""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
_INSTALLED = _PACKAGE / "_shipped"
ROOT = _INSTALLED if _INSTALLED.is_dir() else _PACKAGE.parents[1]
SHIPPED = ROOT / "config"
