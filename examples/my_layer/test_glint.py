from csstsim.layer_contract import check_layer


def test_contract():
    assert not check_layer("mylab.glint")
