"""Coarser bodies to collide with: near the body, and carried along by it."""

import numpy as np
import pytest
from cloth_shapes import bent, sphere, tube
from wrinkle_synthesis.wrinkle_addon.body_proxy import make_body_proxy


def test_a_proxy_is_coarser_and_near_its_body():
    positions, faces = sphere(0.1, 4)
    proxy = make_body_proxy(positions, faces, 400)
    assert len(proxy.corners) < 0.2 * len(positions)
    np.testing.assert_allclose(proxy.weights.sum(1), 1.0, atol=1e-6)
    # Edges of 20 mm on a ball of 100 mm bulge by 20^2 / (8 x 100), half a millimetre, and more in a triangle's middle.
    gaps = proxy.gaps(positions)
    assert -1e-4 < gaps.min() and gaps.max() < 0.001
    corners = proxy.carry(positions)[proxy.faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((outward * corners.mean(1)).sum(1) > 0.0).all()


def test_a_proxy_goes_where_the_body_goes():
    positions, faces = tube(61, 40, 0.6, 0.04)
    proxy = make_body_proxy(positions, faces, 600)
    posed = bent(positions, 1.2, positions[:, 0], 0.12)
    # Bent by 69 degrees it is as near as at rest, about: edges of 15 mm on a tube of 40 mm.
    assert np.abs(proxy.gaps(positions)).max() < 0.0025
    assert np.abs(proxy.gaps(posed)).max() < 0.0025


def test_a_body_that_cannot_be_coarsened_is_refused_in_one_sentence():
    positions, faces = sphere(0.1, 2)
    with pytest.raises(ValueError, match=r"No proxy can be made of the body: .*vertices, not 100000") as found:
        make_body_proxy(positions, faces, 100_000)
    assert str(found.value).endswith(".")
