"""Asteroids at opposition, on the ecliptic and off it, compared with published counts; the cost of a search.

    python benchmarks/asteroid_counts.py

R = V - 0.4. The number of config/changing/asteroids.yaml was set to the count of Heinze et al. (2019) on the ecliptic.
"""

import argparse
import time

from evidence.record import Record

import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.changing.visitors import _radius
from csstsim.instrument.camera import load_camera
from csstsim.universe.changing.asteroids import OBLIQUITY, asteroids_near, population
from csstsim.universe.changing.numbers import numbers_of

MJD = 61700.0
FAINTEST = 25.4  # V: R < 25.0
HEINZE, ERROR = 697.0, 15.0  # deg-2
RADIUS, TOY_RADIUS = 3.0, 0.3  # deg
OFF = 20.0  # deg, ecliptic latitude


def main(record: Record) -> None:
    numbers = numbers_of(SHIPPED / "universe", "asteroids")
    craft = observer(MJD, (6778.0, 0.0, 0.0), (0.0, 7.0, 3.0))  # km, km / s
    sun = craft.astrom["eh"] * craft.astrom["em"]
    opposition = sun / np.linalg.norm(sun)
    pole = np.array([0.0, -np.sin(OBLIQUITY), np.cos(OBLIQUITY)])
    away = np.cos(np.radians(OFF)) * opposition + np.sin(np.radians(OFF)) * pole
    radius, faint = TOY_RADIUS if record.toy else RADIUS, numbers | {"faintest": FAINTEST}
    record.value(
        "orbits", int(population(numbers).number.sum()), f"orbits that can be brighter than V = {numbers['faintest']:g}"
    )
    densities = []
    for direction in (opposition, away):
        found = len(asteroids_near(1, MJD, sun, direction, np.radians(radius), faint)["id"])
        densities.append((found / (np.pi * radius**2), np.sqrt(found) / (np.pi * radius**2)))
    (near, error), (far, far_error) = densities
    met = bool(abs(near - HEINZE) < 2 * np.hypot(error, ERROR))
    what = f"asteroids per deg2 of R < {FAINTEST - 0.4:g} at opposition"
    record.value("opposition", near, f"{what}, on the ecliptic", error=error, goal=met)
    record.value("off", far, f"{what}, {OFF:g} deg off the ecliptic", error=far_error)
    ratio = far / near
    record.value(
        "off_ratio", ratio, "the latter over the former", error=ratio * np.hypot(error / near, far_error / far)
    )
    for name, direction, where in (("ecliptic", opposition, "on the ecliptic"), ("off", away, f"{OFF:g} deg off it")):
        start = time.process_time()
        found = asteroids_near(1, MJD, sun, direction, _radius(load_camera()), numbers)
        seconds = time.process_time() - start
        record.value(f"search_{name}", seconds, f"search for an exposure's asteroids, {where}", unit="CPU-s")
        record.value(f"found_{name}", len(found["id"]), f"asteroids of V < {numbers['faintest']:g} found by it")


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
