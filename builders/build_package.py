"""What hatch asks when it builds a wheel or a source distribution (pyproject.toml, tool.hatch).

The README of the package has absolute addresses: a package index shows it without the files beside it. They are those
of the tag of the version, below `Source` of [project.urls]. The commit is noted in the package (csstsim.base.commit).
With CSSTSIM_KERNELS, the wheel has that folder of compiled code, made by builders/build_kernels.py.
"""

import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

RELATIVE_LINK = re.compile(r"(!?)(\[[^\]]*\])\((?!https?:|#)([^)]+)\)")


class AbsoluteReadme(MetadataHookInterface):
    """Sets the field `readme`."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the text of README.md, in which links and images lead to the repository."""
        source, tag = metadata["urls"]["Source"], f"v{metadata['version']}"

        def absolute(link: re.Match[str]) -> str:
            image, text, path = link.groups()
            return f"{image}{text}({source}/{'raw' if image else 'blob'}/{tag}/{path})"

        text = RELATIVE_LINK.sub(absolute, (Path(self.root) / "README.md").read_text())
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


class AddedFiles(BuildHookInterface):
    """Adds the file with the commit to a wheel and to a source distribution, and compiled code to a wheel.

    An editable wheel has the files of its clone.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the file, if the commit is known, and the compiled code, if there is some."""
        sys.path.insert(0, str(Path(self.root) / "src"))
        from csstsim.base.commit import NOTE, commit_of
        from csstsim.base.process.shipped_kernels import KERNELS, VARIABLE

        if (kernels := os.environ.get(VARIABLE)) and self.target_name == "wheel" and version != "editable":
            build_data["force_include"][str(Path(self.root) / kernels)] = f"csstsim/{KERNELS}"
        commit = commit_of(Path(self.root))
        if commit and version != "editable":
            self.folder = tempfile.TemporaryDirectory()  # removed with this object
            note = Path(self.folder.name) / NOTE
            note.write_text(f"{commit}\n")
            build_data["force_include"][str(note)] = f"csstsim/_shipped/{NOTE}" if self.target_name == "wheel" else NOTE
