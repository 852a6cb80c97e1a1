"""Counter-based random streams identified by words: equal words always give equal numbers.

The generator is Philox (Salmon et al. 2011). The key of a stream is the SHA-256 of "seed/word/word/...". So streams do
not collide, as sums of seeds and ids would, and do not depend on the order of work, on threads or on resumed jobs.
"""

from __future__ import annotations

import copy
import hashlib
from typing import TYPE_CHECKING, Self

import numpy as np

if TYPE_CHECKING:
    from hashlib import _Hash


def _begun(seed: int, *key: object) -> _Hash:
    """Return the hash of the first words of a key; `_digest` adds the other words."""
    return hashlib.sha256("/".join(_words(seed, *key)).encode())


def _digest(begun: _Hash, *key: object) -> bytes:
    """Return the 32 bytes of a key whose first words are already hashed."""
    complete = begun.copy()
    complete.update("".join(f"/{word}" for word in _words(*key)).encode())
    return complete.digest()


def _words(*key: object) -> list[str]:
    words = list(map(str, key))
    if any("/" in word for word in words):
        raise ValueError(f"a stream word holds '/': {words}")
    return words


def _generator(digest: bytes) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=int.from_bytes(digest[:16], "little")))


def stream(seed: int, *key: object) -> np.random.Generator:
    """Return a random generator for these words.

    Parameters
    ----------
    seed : int
        The campaign's seed.
    *key : object
        Words that name the stream, without "/".

    Returns
    -------
    numpy.random.Generator
        Of the bit generator Philox; the same words give the same numbers.

    Raises
    ------
    ValueError
        For a word with a "/" in it.

    Examples
    --------
    >>> from csstsim.base.rng import stream
    >>> stream(1, "stars").random() == stream(1, "stars").random()
    True
    """
    return _generator(_digest(_begun(seed), *key))


def counter_key(seed: int, *key: object) -> np.uint64:
    """Return a key for the counters of compiled loops (csstsim.base.counter).

    Parameters
    ----------
    seed : int
        The campaign's seed.
    *key : object
        Words that name the stream, without "/".

    Returns
    -------
    numpy.uint64
        64 bits.
    """
    return _counter_key(_digest(_begun(seed), *key))


class Streams:
    """The random streams of one layer in one exposure of one chip; its methods differ in what the numbers depend on.

    It stores hashes of seed, obsid and chip, not the words.

    Parameters
    ----------
    seed : int
        The campaign's seed.
    obsid : str
        Observation id of the exposure.
    chip_id : int
        Number of the chip.
    keyword : str
        The layer's keyword.
    """

    def __init__(self, seed: int, obsid: str, chip_id: int, keyword: str) -> None:
        self._exposure = _begun(seed, "exposure", obsid, chip_id)
        self._keyword = keyword
        self._object = _begun(seed, "object", obsid, chip_id)
        self._chip = _begun(seed, "chip", chip_id)
        self._channel = _begun(seed, "channel", chip_id)
        self._camera = _begun(seed, "camera")

    def layer(self, keyword: str) -> Self:
        """Return the random streams of another layer in the same exposure and chip.

        Parameters
        ----------
        keyword : str
            The layer's keyword.

        Returns
        -------
        Streams
            Of that layer.
        """
        other = copy.copy(self)
        other._keyword = keyword
        return other

    def exposure(self, name: str) -> np.random.Generator:
        """Return a generator that is new in each exposure and chip: shot noise, read noise, tracks.

        Parameters
        ----------
        name : str
            Name of the stream.

        Returns
        -------
        numpy.random.Generator
            Its numbers depend on seed, exposure, chip, layer and name.
        """
        return _generator(_digest(self._exposure, self._keyword, name))

    def chip(self, name: str) -> np.random.Generator:
        """Return a generator that is the same in all exposures of the chip.

        Parameters
        ----------
        name : str
            Name of the effect, not of the layer: several layers may use one pattern.

        Returns
        -------
        numpy.random.Generator
            Its numbers depend on seed, chip and name.
        """
        return _generator(_digest(self._chip, name))

    def channel(self, channel: int, name: str) -> np.random.Generator:
        """Return a generator that is the same in all exposures, for one readout channel of the chip.

        Parameters
        ----------
        channel : int
            Number of the channel, 1 to 16.
        name : str
            Name of the effect.

        Returns
        -------
        numpy.random.Generator
            Its numbers depend on seed, chip, channel and name.
        """
        return _generator(_digest(self._channel, channel, name))

    def exposure_key(self, name: str) -> np.uint64:
        """Return a key as `exposure`, for the counters of compiled loops (csstsim.base.counter).

        Parameters
        ----------
        name : str
            Name of the stream.

        Returns
        -------
        numpy.uint64
            64 bits.
        """
        return _counter_key(_digest(self._exposure, self._keyword, name))

    def chip_key(self, name: str) -> np.uint64:
        """Return a key as `chip`, for the counters of compiled loops (csstsim.base.counter).

        Parameters
        ----------
        name : str
            Name of the effect.

        Returns
        -------
        numpy.uint64
            64 bits.
        """
        return _counter_key(_digest(self._chip, name))

    def camera(self, name: str) -> np.random.Generator:
        """Return a generator that is the same for the whole camera.

        Parameters
        ----------
        name : str
            Name of the effect.

        Returns
        -------
        numpy.random.Generator
            Its numbers depend on seed and name.
        """
        return _generator(_digest(self._camera, name))

    def object(self, object_id: object) -> np.random.Generator:
        """Return a generator for one object in this exposure and chip, which does not depend on other objects or on
        threads.

        Parameters
        ----------
        object_id : object
            The object's id.

        Returns
        -------
        numpy.random.Generator
            Its numbers depend on seed, exposure, chip and id.
        """
        return _generator(_digest(self._object, object_id))


def _counter_key(digest: bytes) -> np.uint64:
    return np.uint64(int.from_bytes(digest[:8], "little"))
