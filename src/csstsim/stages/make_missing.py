"""Products that a stage needs and that are not there, made first: `csstsim chip` and Python have no workflow."""

from csstsim.base.progress import progress


def make_missing(wanted, say):
    """Make those of {path: function that makes it} that are not there."""
    for path in progress([path for path in wanted if not path.exists()], "made first"):
        if not path.exists():  # tables come with a new PSF set
            say(f"missing, made first: {path}")
            wanted[path]()
