"""A PSF set of 3 x 3 nodes in the r band, made once, with the files that `csstsim bench` keeps next to it."""

import pytest


@pytest.fixture(scope="session")
def bench_folder(tmp_path_factory):
    from csstsim.bench import setting

    folder = tmp_path_factory.mktemp("bench")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setting, "GRID", 3)
        setting.make_setting(folder, "r")
    return folder
