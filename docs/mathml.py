"""A Sphinx extension that writes formulae as MathML. Browsers draw it by themselves: no script, no network."""

from docutils import nodes
from latex2mathml.converter import convert


def _in_line(translator, node):
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _on_lines(translator, node):
    formula = convert(node.astext(), display="block")
    translator.body.append(f"{translator.starttag(node, 'div', CLASS='math')}{formula}</div>\n")
    raise nodes.SkipNode


def setup(app):
    """Register the renderer, whose name conf.py's html_math_renderer gives."""
    app.add_html_math_renderer("mathml", (_in_line, None), (_on_lines, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
