"""config/README.md, config/schema/ and docs/products.md say what the code says."""

import runpy
from pathlib import Path

import pytest

CONFIG = Path(__file__).parents[1] / "config"


@pytest.mark.parametrize("script", ["make_docs.py", "make_products.py"])
def test_generated_documents_have_not_drifted(script):
    documents = runpy.run_path(str(CONFIG / script))["documents"]()
    stale = [path.name for path, text in documents.items() if not path.exists() or path.read_text() != text]
    assert not stale, f"run python config/{script}: {stale}"
