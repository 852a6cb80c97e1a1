"""Counter-based random streams named by words (design: the same words give the same numbers, always).

The generator is Philox (Salmon et al. 2011); a stream's key is the SHA-256 of "seed/word/word/...", so streams never
collide as sums of seeds and ids do, and nothing depends on the order of work, on threads or on jobs killed and resumed.
"""

import hashlib
from dataclasses import dataclass

import numpy as np


def _digest(seed, key):
    words = [str(seed), *map(str, key)]
    if any("/" in word for word in words):
        raise ValueError(f"a stream word holds '/': {words}")
    return hashlib.sha256("/".join(words).encode()).digest()


def stream(seed, *key):
    """Return a `numpy.random.Generator` (Philox) for this campaign seed and these words.

    Raises ValueError for a word with a "/" in it.
    """
    return np.random.Generator(np.random.Philox(key=int.from_bytes(_digest(seed, key)[:16], "little")))


def galsim_seed(seed, *key):
    """Return a seed for `galsim.BaseDeviate`, never 0 (which GalSim reads as the clock).

    Raises ValueError as `stream` does.
    """
    return int.from_bytes(_digest(seed, key)[16:20], "little") % (2**31 - 1) + 1


@dataclass(frozen=True)
class Streams:
    """The random streams of one layer in one exposure of one chip; each method says how long a draw lives."""

    seed: int
    obsid: str
    chip_id: int
    keyword: str

    def exposure(self, name):
        """New in each exposure and chip: shot noise, read noise, tracks."""
        return stream(self.seed, "exposure", self.obsid, self.chip_id, self.keyword, name)

    def chip(self, name):
        """Fixed for the chip. Keyed by the effect's name, not the layer: several layers may see one pattern."""
        return stream(self.seed, "chip", self.chip_id, name)

    def channel(self, channel, name):
        """Fixed for one readout channel (1..16) of the chip."""
        return stream(self.seed, "channel", self.chip_id, channel, name)

    def exposure_key(self, name):
        """Return 64 bits (numpy.uint64), as `exposure`, for the counters of compiled loops (csstsim.base.counter)."""
        return self._key("exposure", self.obsid, self.chip_id, self.keyword, name)

    def chip_key(self, name):
        """Return 64 bits (numpy.uint64), as `chip`, for the counters of compiled loops."""
        return self._key("chip", self.chip_id, name)

    def _key(self, *words):
        return np.uint64(int.from_bytes(_digest(self.seed, words)[:8], "little"))

    def camera(self, name):
        """Fixed for the whole camera."""
        return stream(self.seed, "camera", name)

    def object(self, object_id):
        """One object in this exposure: independent of order, neighbours and threads."""
        return stream(self.seed, "object", self.obsid, self.chip_id, object_id)
