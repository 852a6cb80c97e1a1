"""Tables of a brick's numbers by band: each number in its column, with its digits."""

from csstsim.report.band_table import band_numbers, band_table


def spread(n, median, sigma):
    return {"n": n, "median": median, "sigma": sigma, "error": 0.001}


BANDS = {
    "nuv": {
        "frames": 2, "zeropoint": 24.1234, "depth_5sigma": 25.678, "completeness": 0.98765, "point_sources": 41,
        "star": spread(31, 0.012345, 0.04567), "galaxy": spread(2, -0.0234, 0.3),
        "galaxy_kron": spread(17, 0.1357, 1.0),
    },
    "r": {
        "frames": 1, "zeropoint": 25.0, "depth_5sigma": None, "completeness": None, "point_sources": 0,
        "star": spread(0, None, None), "galaxy": spread(3, 0.5, 0.25), "galaxy_kron": spread(3, None, None),
        "curve": {"n": [1, 2], "deep": {"width": 1.5}}, "kind": "late", "flag": None,
    },
}  # fmt: skip


def test_each_number_is_in_its_column():
    table = band_table({"bands": BANDS}, {"nuv": "NUV"})
    assert [dict(zip(range(len(row)), row, strict=True)) for row in table.rows] == [
        dict(enumerate((
            "NUV", 2, "24.12", "25.68", "0.988", 41, "0.0123", "0.046", 31, "-0.023", None, 2, "0.136",
        ))),
        dict(enumerate(("r", 1, "25.00", None, None, 0, None, None, 0, "0.500", "0.250", 3, None))),
    ]  # fmt: skip
    assert table.head == (
        "band", "frames", "zero point [AB, 1 e-/s]", "5 sigma depth [AB]", "completeness", "point sources",
        "stars: out - in [mag]", "scatter", "stars", "galaxies: out - in [mag]", "scatter", "galaxies",
        "galaxies, Kron: out - in [mag]",
    )  # fmt: skip


def test_all_numbers_are_rows_and_bands_columns():
    table = band_numbers({"bands": BANDS}, {"r": "R"})
    assert table.head == ("number", "nuv", "R") and table.name == "numbers"
    rows = {name: values for name, *values in table.rows}
    assert rows["frames"] == [2, 1] and rows["star: sigma"] == [0.04567, None]
    assert rows["curve: deep: width"] == [None, 1.5] and rows["kind"] == [None, "late"] and rows["flag"] == [None] * 2
    assert "curve: n" not in rows and list(rows)[:3] == ["frames", "zeropoint", "depth_5sigma"]
