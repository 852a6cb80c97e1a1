"""A file of the chain damaged between two stages, by a flipped bit or cut short, is refused by name or harmless."""

import numpy as np
import pytest
from faults.small_run import BRICK, CHIP

from csstsim.base.errors import InputError

pytestmark = pytest.mark.faults
FLIPS, SEED = 3, 5  # places in a file, besides its first and last bytes
# Each file, and the stage that reads it
READERS = {
    "truth brick": "select", "psf": "render", "psf tables": "render", "select": "render", "render": "readout",
    "readout": "level0", "drawn": "level0", "level0": "measure", "measure": "merge", "level0 truth": "validate",
    "merged brick": "validate", "validate": "report", "figure": "report",
}  # fmt: skip


def path_of(small_run, kind):
    run, job = small_run.opened
    paths = {
        "truth brick": run.paths.truth(BRICK), "psf": run.paths.psf(CHIP), "psf tables": run.paths.psf_tables(CHIP),
        "level0": run.paths.level0(job), "measure": run.paths.measure(*job.key),
        "level0 truth": run.paths.level0_truth(job), "merged brick": run.paths.merge(BRICK),
        "validate": run.paths.validate(BRICK), "figure": run.paths.validate(BRICK).with_suffix(".png"),
    }  # fmt: skip
    return paths.get(kind) or next((small_run.out / "chips").glob(f"*/{kind}.*"))


def damages(data, flips=FLIPS):
    """Yield (what, damaged bytes): a bit flipped at both ends and in places of a fixed seed, or cut."""
    size = len(data)
    for place in (0, size - 1, *np.random.default_rng(SEED).integers(0, size, flips)):
        flipped = bytearray(data)
        flipped[place] ^= 1 << int(place) % 8
        yield f"bit {int(place) % 8} of byte {place} flipped", bytes(flipped)
    for length in (0, size // 2, size - 1):
        yield f"cut to {length} bytes", data[:length]


@pytest.fixture(scope="module")
def whole(small_run):
    """The finished campaign with its intermediates."""
    small_run.back_before("report", ("select", "render", "drawn", "readout"))
    small_run.stage("report")
    return small_run


@pytest.mark.parametrize("kind", READERS)
def test_a_damaged_file_is_refused_by_name_or_does_not_matter(whole, kind, tell):
    path, refused = path_of(whole, kind), 0
    data, chain = path.read_bytes(), whole.steady_files()
    for what, damaged in (found := list(damages(data))):
        path.write_bytes(damaged)
        try:
            whole.stage(READERS[kind])
        except InputError as exc:
            refused += 1
            assert str(path) in str(exc), f"{kind}, {what}"
        path.write_bytes(data)
        assert whole.steady_files() == chain, f"{kind}, {what}"
    assert refused >= 3, "the file is read"
    fine = len(found) - refused
    rest = f"; {fine} times the same products" if fine else ""
    tell(f"{kind} damaged: a bit flipped, cut", f"{len(found)} places", f"{refused} times refused by its name{rest}")


@pytest.mark.parametrize("kind, cut", [("readout", False), ("truth brick", True)])
def test_the_file_a_message_names_is_removed_and_the_run_goes_on(small_run, tell, kind, cut):
    rule = READERS[kind]
    small_run.back_before(rule, ("readout", "drawn"))
    path = path_of(small_run, kind)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data[: len(data) // 2] if cut else data)
    small_run.refused(f"FAILED {rule} ", f"csstsim: error: {path}")
    small_run.assert_nothing_wrong(but=small_run.name(path))
    path.unlink()
    small_run.resume()
    small_run.assert_as_undisturbed()
    happened = "its reader names it and ends the run; removed, it is made again by the same command"
    tell(f"{kind} {'truncated' if cut else 'with a byte flipped'}", f"before {rule}", happened)
