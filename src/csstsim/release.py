"""What is not of here: campaign files of another layout, products of another release or campaign."""

from csstsim import __version__
from csstsim.errors import InputError

# Layouts of campaign files, each with what a file of the one before it needs to become one
LAYOUTS = {1: "give schema_version: 1, and the keys of config/README.md"}
NEWEST = max(LAYOUTS)


def check_layout(version):
    """Return a campaign file's schema_version. Raises ValueError, which says what to change, for another layout."""
    if 0 <= version < NEWEST:
        steps = "; ".join(LAYOUTS[number] for number in range(version + 1, NEWEST + 1))
        raise ValueError(f"an older layout than this csstsim reads, {NEWEST}; to change: {steps}")
    if version != NEWEST:
        raise ValueError(f"this csstsim reads layout {NEWEST}; a newer file needs a newer csstsim")
    return version


def release(version=__version__):
    """Return the first two numbers of a version: those of one release make the same products, bit by bit."""
    return ".".join(str(version).split(".")[:2])


def check_release(path, version):
    """Refuse a product that another release (`version`, as it records it; None: it does not say) made."""
    if version is None or release(version) != release():
        raise InputError(
            "made by another version of csstsim, whose products are not mixed with those of this one; remove it and "
            "make it again, or go on with the version that made it", file=path, key="csstsim", value=version,
            allowed=f"{release()}.*",
        )  # fmt: skip


def check_recipe(path, meta, recipe):
    """Refuse a file whose record says it was made from something else than `recipe`, or by another release."""
    found = meta.get("recipe")
    if found != recipe:
        check_release(path, (found if isinstance(found, dict) else meta).get("csstsim"))
        raise InputError("made for another campaign; remove it", file=path, key="recipe", value=found, allowed=recipe)
