"""One-to-one matching: each object is matched with at most one other, the best pairs first.

Every pair within reach is a candidate. Candidates are sorted by preference (positions: the closest first, ties in the
order of rows), and a pair is accepted if both members are still free. So the result does not depend on threads or on
the order of a search.
"""

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray


def one_to_one(positions: FloatArray, others: FloatArray, reach: FloatArray) -> IntArray:
    """Return the row of the match of each position among the others.

    The time is proportional to the number of candidates: linear in n and m at a given density.

    Parameters
    ----------
    positions : ndarray (n, d)
        Points in d dimensions.
    others : ndarray (m, d)
        The points to match, in the same unit.
    reach : ndarray (n,)
        Maximum distance of the match of each position, in the same unit.

    Returns
    -------
    ndarray (n,) of int
        Row in `others`; -1 for a position without a match.

    Examples
    --------
    >>> one_to_one(np.array([[0.0], [1.0]]), np.array([[0.9], [5.0]]), np.full(2, 0.5)).tolist()
    [-1, 0]
    """
    from scipy.spatial import cKDTree

    match = np.full(len(positions), -1)
    if len(positions) == 0 or len(others) == 0:
        return match
    candidates = cKDTree(others).query_ball_point(positions, reach)
    position = np.repeat(np.arange(len(positions)), [len(rows) for rows in candidates])
    other = np.concatenate([np.zeros(0, int), *filter(None, candidates)]).astype(int)
    distance = np.linalg.norm(positions[position] - others[other], axis=1)
    ranking = np.lexsort((other, position, distance))
    position = position[ranking]
    other = other[ranking]
    accepted = greedy_match(position, other)
    match[position[accepted]] = other[accepted]
    return match


@numba.njit(cache=True)
def greedy_match(first: IntArray, second: IntArray) -> BoolArray:
    """Return a mask (k,) of the pairs (first[k], second[k]) that are accepted, each member in one pair at most.

    Pairs are sorted, best first. A pair is accepted if no earlier accepted pair has one of its members. first and
    second (k,) are numbers from 0.
    """
    accepted = np.zeros(len(first), np.bool_)
    if len(first) > 0:
        free_first = np.ones(first.max() + 1, np.bool_)
        free_second = np.ones(second.max() + 1, np.bool_)
        for k in range(len(first)):
            if free_first[first[k]] and free_second[second[k]]:
                free_first[first[k]] = free_second[second[k]] = False
                accepted[k] = True
    return accepted
