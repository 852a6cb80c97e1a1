"""Builder of `shift` in config/universe/galaxies.yaml: abundance matching of the model's i counts to `counts`.

Galaxies are placed evenly over the cells of the mass grid and weighted by the density there, so that the counts of rare
bright ones are accurate, too. shift(i) makes N_model(< i) equal N_counts(< i + shift). Prints YAML.

    PYTHONPATH=tests:builders python builders/build_galaxy_counts.py
"""

import numpy as np
from support.galaxy_sample import numbers, population

from csstsim.base.rng import stream
from csstsim.universe.galaxies.galaxies import cumulative_counts

KNOTS = np.arange(16.0, 31.25, 0.5)
EACH = 8  # galaxies per cell


def main():
    plain = numbers() | {"shift": [[10, 0], [35, 0]]}
    wide = plain | {"density": 3 * plain["density"]}
    wide["margin"] = wide["margin"] | {"dex": wide["margin"]["dex"] + 0.4}
    model = population(wide)
    cells = np.repeat(np.argwhere(model.grid.density > 0), EACH, axis=0).T
    weight = model.grid.density[tuple(cells)] / EACH
    i = model.properties(lambda name: stream(1, "counts", name), *model.grid.draw_in_cells(stream(1, "place"), *cells))[
        "i"
    ]
    order = np.argsort(i)
    below = np.interp(KNOTS, i[order], np.cumsum(weight[order]))
    mag, total = cumulative_counts(wide)
    shift = np.interp(np.log(below), np.log(total), mag) - KNOTS
    print("  values: [" + ", ".join(f"[{k:.1f}, {s:.3f}]" for k, s in zip(KNOTS, shift, strict=True)) + "]")


if __name__ == "__main__":
    main()
