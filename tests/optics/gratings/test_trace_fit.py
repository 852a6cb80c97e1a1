"""Traces fitted to trajectories: known coefficients are recovered, shipped ones are within 0.2 px; the command."""

import numpy as np
import pytest
from build_gratings import described, print_samples
from click.testing import CliRunner

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.command_line.main import main
from csstsim.instrument.axe import COEFFICIENTS, field_terms, read_axe
from csstsim.instrument.load import read_data
from csstsim.optics.gratings.trace_fit import COLUMNS, fit_report, fit_traces, read_trajectories, residuals

KNOWN = {  # over a whole chip: angstrom / px to 1%, slopes to 1e-3
    "a0": [2.0, 1e-4, -2e-4, 1e-9, 3e-9, -2e-9],
    "a1": [1e-3, 5e-8, -1e-7, 1e-12, 2e-12, -3e-12],
    "alpha0": [-30.0, 2e-3, 1e-3, 1e-8, -2e-8, 3e-8],
    "alpha1": [-8.5, 5e-6, -4e-6, 2e-10, 1e-10, -1e-10],
}


def samples(known, positions=10, waves=8):
    """Return (k, 5) samples that lie on traces of known coefficients, by solving equations 1 and 2 for x."""
    m, n, wave = (v.ravel() for v in np.meshgrid(*[np.linspace(-500, 9700, positions)] * 2,
                                                 np.linspace(6060.0, 10700.0, waves)))  # fmt: skip
    a0, a1, alpha0, alpha1 = (field_terms(m, n) @ np.array(known[name]) for name in KNOWN)
    length = (wave - alpha0) / alpha1
    x = length / np.sqrt(1.0 + a1**2)
    return np.stack([m, n, wave, m + x, n + a0 + a1 * x], axis=1)


@pytest.mark.parametrize("positions, waves", [(10, 8), (3, 2)])
def test_known_coefficients_come_back(positions, waves):
    rows = samples(KNOWN, positions, waves)
    found = fit_traces({1: rows})[1]
    assert residuals(found, rows).max() < 1e-7  # px
    for name, known in KNOWN.items():
        at_edge = field_terms(9700.0, 9700.0) * (found[name] - known)
        np.testing.assert_allclose(at_edge, 0.0, atol=1e-6 * abs(known[0]))
    assert not found["xoff"].any() and not found["yoff"].any()
    x = rows[:, 3] - rows[:, 0]
    assert found["extent"] == (np.floor(x.min()), np.ceil(x.max()))


def test_the_extent_holds_the_samples_and_the_fit():
    """The dispersion of the samples is bent by 6 px at one end: the straight fit ends elsewhere than the samples."""
    rows = samples(KNOWN)
    t = (rows[:, 2] - rows[:, 2].min()) / np.ptp(rows[:, 2])
    for bend in (6.0, -6.0):
        bent = rows + np.array([0, 0, 0, 1, 0]) * (bend * t**2)[:, None]
        found = fit_traces({1: bent})[1]
        m, n, wave, x, _ = bent.T
        _, a1, alpha0, alpha1 = (field_terms(m, n) @ found[name] for name in KNOWN)
        both = [*(x - m), *((wave - alpha0) / alpha1 / np.hypot(1.0, a1))]
        assert found["extent"] == (np.floor(min(both)), np.ceil(max(both)))


def test_an_undispersed_order():
    """An image 8 px off that moves by 1 px along the band, and by 2 px over the chip; one that does not disperse."""
    rows = samples(KNOWN)
    m, n, wave = rows[:, :3].T
    rows[:, 3] = m + 8.0 + 2.0 * m / 9216 + (wave - 8000.0) / 4640.0
    rows[:, 4] = n + 2.0 + 1e-9 * m * n
    found = fit_traces({0: rows})[0]
    assert residuals(found, rows).max() < 1e-6  # px
    assert not found["a1"].any() and found["alpha1"][0] == pytest.approx(4640.0, rel=1e-9)
    rows[:, 3] = m - 8.0
    fixed = fit_traces({0: rows})[0]
    assert residuals(fixed, rows).max() == pytest.approx(5e-4, rel=1e-3)  # px: the least dispersion there is


@pytest.mark.parametrize("cut, message", [
    (lambda rows: rows[rows[:, 2] == rows[0, 2]], "two wavelengths"),
    (lambda rows: rows[rows[:, 0] == rows[0, 0]], "do not determine"),
    (lambda rows: rows[(rows[:, 0] < 0) | (rows[:, 0] > 9000)], "do not determine"),
])  # fmt: skip
def test_samples_that_do_not_determine(cut, message):
    with pytest.raises(ValueError, match=message):
        fit_traces({1: cut(samples(KNOWN))})


def test_shipped_gratings_keep_the_papers_residual(camera):
    """0.2 px between the 24 committed files and 10 x 10 x 8 trajectories, in the working orders; 1.1 px in all."""
    folder = SHIPPED / "instrument"
    found = {}
    for name, (*_, trajectories) in described(camera, read_data(folder / "gratings.yaml")).items():
        orders = read_axe(folder / "gratings" / f"{name}.conf")
        assert all(len(rows) == 10 * 10 * 8 for rows in trajectories.values())
        found[name] = {order: residuals(orders[order], rows).max() for order, rows in trajectories.items()}
    assert len(found) == 24
    assert max(px[order] for px in found.values() for order in (0, 1)) < 0.12
    assert max(px[-1] for px in found.values()) < 0.17
    assert max(max(px.values()) for px in found.values()) < 1.1


def run(*arguments):
    return CliRunner().invoke(main, ["fit-grating", *map(str, arguments)], catch_exceptions=False)


def test_command_on_the_shipped_samples(tmp_path, capsys):
    """The committed GI1 comes back from its samples as CSV (rounded to 1e-5 px), with its residuals in the table."""
    print_samples("GI1")
    (tmp_path / "samples.csv").write_text(capsys.readouterr().out)
    result = run(tmp_path / "samples.csv", "--output", tmp_path / "new" / "GI1.conf", "--sensitivity", "GI")
    assert result.exit_code == 0
    lines = result.output.splitlines()
    assert lines[0].split() == ["order", "samples", "rms", "[px]", "worst", "[px]"]
    assert [line.split()[0] for line in lines[1:]] == ["-2", "-1", "+0", "+1", "+2"]
    assert lines[4].split()[1:] == ["800", "0.0535", "0.1145"]
    made, shipped = (read_axe(p) for p in (tmp_path / "new" / "GI1.conf", SHIPPED / "instrument/gratings/GI1.conf"))
    for order, rows in read_trajectories(tmp_path / "samples.csv").items():
        assert residuals(made[order], rows) == pytest.approx(residuals(shipped[order], rows), abs=1e-4)  # px
        assert made[order]["sensitivity"] == shipped[order]["sensitivity"]
        assert set(made[order]) == {"extent", "sensitivity", *COEFFICIENTS}


def test_command_says_what_is_above_the_papers(tmp_path):
    rows = samples(KNOWN)
    rows[:, 3] += 1e-7 * (rows[:, 2] - 8000.0) ** 2  # px; a curved dispersion
    write(tmp_path / "s.csv", rows)
    result = run(tmp_path / "s.csv", "--output", tmp_path / "s.conf")
    assert result.exit_code == 0 and "above the 0.2 px of the paper" in result.output
    assert read_axe(tmp_path / "s.conf")[1]["sensitivity"] == "s_p1.fits"


HEAD = ",".join(COLUMNS)


def write(path, rows, order=1, head=HEAD):
    path.write_text("\n".join([head, *(f"{order}," + ",".join(map(str, row)) for row in rows)]))


BAD = {
    "no file": (lambda p: p.unlink(), "No such file"),
    "empty": (lambda p: p.write_text(""), "order: needs one such column"),
    "heading only": (lambda p: p.write_text(HEAD), "no samples"),
    "no column": (lambda p: write(p, samples(KNOWN), head="order,m,n,lambda,x,y"), "wavelength: needs one such column"),
    "column twice": (lambda p: write(p, samples(KNOWN), head="order,m,n,wavelength,x,x"), "x: needs one such column"),
    "short row": (lambda p: p.write_text(p.read_text() + "\n1,2,3"), "row 802: not numbers"),
    "word": (lambda p: p.write_text(p.read_text() + "\n1,2,3,blue,5,6"), "row 802: not numbers"),
    "not a number": (lambda p: p.write_text(p.read_text() + "\n1,2,3,nan,5,6"), "row 802: out of range"),
    "huge": (lambda p: p.write_text(p.read_text() + "\n1,2,3,6000,1e300,6"), "row 802: out of range"),
    "order 3": (lambda p: p.write_text(p.read_text() + "\n3,2,3,6000,5,6"), "row 802: out of range"),
    "negative wavelength": (lambda p: p.write_text(p.read_text() + "\n1,2,3,-6000,5,6"), "row 802: out of range"),
    "no first order": (lambda p: write(p, samples(KNOWN), order=2), "the first order is missing"),
    "too few": (lambda p: write(p, samples(KNOWN, 2, 2)), "do not determine the coefficients"),
    "binary": (lambda p: p.write_bytes(b"\xff\xfe\x00"), "cannot be read"),
}  # fmt: skip


@pytest.mark.parametrize("spoil, message", BAD.values(), ids=BAD)
def test_command_refuses(tmp_path, spoil, message):
    """Exit code 2, one line, and the output as it was."""
    path, output = tmp_path / "s.csv", tmp_path / "out.conf"
    write(path, samples(KNOWN))
    output.write_text("before")
    spoil(path)
    result = run(path, "--output", output)
    assert result.exit_code == 2 and message in result.output and result.output.count("\n") == 1
    assert output.read_text() == "before" and {p.name for p in tmp_path.iterdir()} <= {"s.csv", "out.conf"}


def test_command_writes_conf_only(tmp_path):
    write(tmp_path / "s.csv", samples(KNOWN))
    result = run(tmp_path / "s.csv", "--output", tmp_path / "s.csv")
    assert result.exit_code == 2 and "must end in .conf" in result.output


def test_bad_table_read_alone(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_trajectories(tmp_path)


@pytest.mark.parametrize("stem", ["../a b", "a b", "a/b"])
def test_sensitivities_have_plain_names(tmp_path, stem):
    write(tmp_path / "s.csv", samples(KNOWN))
    result = run(tmp_path / "s.csv", "--output", tmp_path / "s.conf", "--sensitivity", stem)
    assert result.exit_code == 2 and "sensitivity: must be a name" in result.output
    assert not (tmp_path / "s.conf").exists()


def test_the_report_gives_number_rms_and_worst_of_each_order():
    """The paper's 0.2 px are for the working orders, 0 and 1, and for the worst sample."""
    lines = fit_report({0: np.array([0.2]), 1: np.array([0.1, 0.1, 0.1, 0.25]), 2: np.array([3.0, 4.0])})
    assert [" ".join(line.split()) for line in lines] == [
        "order samples rms [px] worst [px]",
        "+0 1 0.2000 0.2000",
        "+1 4 0.1521 0.2500 above the 0.2 px of the paper",
        "+2 2 3.5355 4.0000",
    ]


@pytest.mark.parametrize(("changes", "good"), [
    ({}, True), ({"wavelength": 0.5}, True), ({"wavelength": 0.0}, False), ({"wavelength": -1.0}, False),
    ({"m": 0.0, "n": -5.0, "x": -2.0, "y": 0.0}, True), ({"m": 999_999.0}, True), ({"m": 1e6}, False),
    ({"n": -1e6}, False), ({"x": "inf"}, False), ({"y": "nan"}, False), ({"wavelength": 1e6}, False),
    ({"order": -2}, True), ({"order": 3}, False), ({"order": 1.5}, False), ({"y": ""}, False),
])  # fmt: skip
def test_each_number_of_a_sample_has_a_range(tmp_path, changes, good):
    values = {"order": 1, "m": 10.0, "n": 20.0, "wavelength": 7000.0, "x": 30.0, "y": 40.0} | changes
    path = tmp_path / "s.csv"
    rows = [COLUMNS, (1, 1.0, 2.0, 6500.0, 3.0, 4.0), [values[name] for name in COLUMNS]]
    path.write_text("".join(",".join(map(str, row)) + "\n" for row in rows))
    if good:
        found = read_trajectories(path)
        assert found[values["order"]][-1].tolist() == [values[name] for name in COLUMNS[1:]]
    else:
        with pytest.raises(InputError, match=r"s\.csv: row 3: "):
            read_trajectories(path)
