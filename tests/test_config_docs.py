"""config/README.md and config/schema/ say what the models say."""

import runpy
from pathlib import Path


def test_generated_documents_have_not_drifted():
    documents = runpy.run_path(str(Path(__file__).parents[1] / "config" / "make_docs.py"))["documents"]()
    stale = [path.name for path, text in documents.items() if not path.exists() or path.read_text() != text]
    assert not stale, f"run python config/make_docs.py: {stale}"
