"""The setting of `csstsim bench` for benchmarks: one chip, its PSF set (kept with the results), an exposure."""

from evidence.record import Record

from csstsim.studies.bench import setting
from csstsim.studies.bench.setting import Setting
from csstsim.studies.bench.slitless import cases, truth

# At the size of seconds: nodes along a side; half of a spectrum's window [px], the largest half-light radius [arcsec],
# wavelengths of direct optics
TOY_GRID, TOY_HALF, TOY_LARGEST, TOY_NODES = 3, 36, 0.15, 4


def small() -> None:
    """Make the objects and the truth of `csstsim bench` those of the size of seconds."""
    setting.GRID, cases.HALF_MAX, cases.LARGEST, truth.NODES = TOY_GRID, TOY_HALF, TOY_LARGEST, TOY_NODES


def setting_of(record: Record, band: str) -> Setting:
    """Return the Setting of a filter."""
    if record.toy:
        small()
    return setting.make_setting(record.results / "bench", band)
