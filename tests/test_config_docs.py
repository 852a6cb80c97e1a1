"""config/README.md and config/schema/ agree with the models."""

import runpy
from pathlib import Path

GENERATOR = Path(__file__).parents[1] / "builders" / "make_docs.py"


def test_generated_documents_have_not_drifted():
    assert not runpy.run_path(str(GENERATOR))["stale"](), "run python builders/make_docs.py"
