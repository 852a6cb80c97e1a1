"""A Sphinx extension: the site shows pictures as WebP where that makes pages lighter.

The repository keeps PNG and JPEG, which every git host shows.
"""

from pathlib import Path

from docutils import nodes
from PIL import Image
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms.images import BaseImageConverter
from sphinx.util.osutil import ensuredir

FORMATS = (".png", ".jpg")
MAX_WIDTH = 1400  # px: one and a half times the text's width, for dense screens
QUALITY = 75  # of lossy WebP, 0 to 100
MIN_GAIN = 0.8  # a WebP larger than this fraction of its source is not used
# Lossless is smaller for drawings, lossy for photographs
SETTINGS: tuple[dict[str, bool | int], ...] = ({"quality": QUALITY}, {"lossless": True})


def to_webp(source: Path, target: Path) -> bool:
    """Write the smallest WebP of a picture; return False, without a file, if it gains too little."""
    with Image.open(source) as picture:
        picture.thumbnail((MAX_WIDTH, picture.height))
        for number, settings in enumerate(SETTINGS):
            candidate = target.with_suffix(f".{number}.webp")
            picture.save(candidate, "WEBP", method=4, **settings)
    *larger, smallest = sorted(
        (target.with_suffix(f".{number}.webp") for number in range(len(SETTINGS))),
        key=lambda path: -path.stat().st_size,
    )
    for path in larger:
        path.unlink()
    if smallest.stat().st_size > MIN_GAIN * source.stat().st_size:
        smallest.unlink()
        return False
    smallest.rename(target)
    return True


class WebpPictures(BaseImageConverter):
    """Replace the pictures of a page by WebP files in the folder of doctrees, where later builds find them."""

    default_priority = 250  # after Sphinx's own converters

    def match(self, node: nodes.image) -> bool:
        """Tell whether the builder writes HTML and the picture is a file of a known format."""
        return self.app.builder.format == "html" and node["uri"].endswith(FORMATS) and "://" not in node["uri"]

    def handle(self, node: nodes.image) -> None:
        """Convert, unless the file is newer than its source."""
        source = self.env.srcdir / node["uri"]
        ensuredir(self.imagedir)
        target = Path(self.imagedir) / Path(self.env.images[node["uri"]][1]).with_suffix(".webp").name
        known = target.exists() and target.stat().st_mtime >= source.stat().st_mtime
        if known or to_webp(source, target):
            self.env.original_image_uri[target] = node["uri"]
            node["uri"] = node["candidates"]["*"] = str(target)
            self.env.images.add_file(self.env.current_document.docname, str(target))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the converter."""
    app.add_post_transform(WebpPictures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
