"""One-to-one matching: each object is matched with at most one other, the best pairs first.

Every pair within reach is a candidate. Candidates are sorted by preference (positions: the closest first, ties in the
order of rows), and each pair is taken if both members are still free. So the result does not depend on threads or on
the order of a search.
"""

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray


def one_to_one(places: FloatArray, others: FloatArray, reach: FloatArray) -> IntArray:
    """Return for each place the row of its match among the others, -1 if there is none, (n,) int.

    places (n, d) and others (m, d) are points, reach (n,) the largest distance of each place's match, in the same
    unit. The time is proportional to the number of candidates: linear in n and m at a given density.
    """
    from scipy.spatial import cKDTree

    row = np.full(len(places), -1)
    if len(places) == 0 or len(others) == 0:
        return row
    near = cKDTree(others).query_ball_point(places, reach)
    first = np.repeat(np.arange(len(places)), [len(rows) for rows in near])
    second = np.concatenate([np.zeros(0, int), *filter(None, near)]).astype(int)
    distance = np.linalg.norm(places[first] - others[second], axis=1)
    order = np.lexsort((second, first, distance))
    first = first[order]
    second = second[order]
    taken = share_out(first, second)
    row[first[taken]] = second[taken]
    return row


@numba.njit(cache=True)
def share_out(first: IntArray, second: IntArray) -> BoolArray:
    """Return a mask of the pairs (first[k], second[k]) that are taken: no better taken pair has one of their members.

    Pairs come best first; first and second (k,) are numbers from 0.
    """
    taken = np.zeros(len(first), np.bool_)
    if len(first) > 0:
        free_first = np.ones(first.max() + 1, np.bool_)
        free_second = np.ones(second.max() + 1, np.bool_)
        for k in range(len(first)):
            if free_first[first[k]] and free_second[second[k]]:
                free_first[first[k]] = free_second[second[k]] = False
                taken[k] = True
    return taken
