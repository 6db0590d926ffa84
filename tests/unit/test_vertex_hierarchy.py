"""Fields over vertices as integers: exact on both sides, never far off, and small where the field is smooth."""

import numpy as np
import pytest
from flow_clips import sleeve
from wrinkle_synthesis.wrinkle_addon.adaptive_code import encode_integers
from wrinkle_synthesis.wrinkle_addon.flow_file import encode_rest, pack, unpack
from wrinkle_synthesis.wrinkle_addon.vertex_hierarchy import ROUNDING, VertexHierarchy

STEP = 1.0e-4


def hierarchy() -> VertexHierarchy:
    return VertexHierarchy(encode_rest(sleeve())[1])


def test_a_reader_gets_what_the_writer_saw_to_the_bit():
    values = np.random.default_rng(1).standard_normal((len(sleeve()), 5)).astype(np.float32) * 0.01
    codes, decoded = hierarchy().quantise(values, STEP)
    assert np.array_equal(hierarchy().restore(codes, STEP), decoded)


def test_no_value_is_off_by_more_than_its_rounding():
    values = np.random.default_rng(2).standard_normal((len(sleeve()), 5)).astype(np.float32) * 0.01
    _, decoded = hierarchy().quantise(values, STEP)
    # Single precision of values near 0.05 adds a little.
    assert np.abs(decoded - values).max() <= (1.0 - ROUNDING) * STEP + 1e-8


def test_smooth_fields_take_less_than_rounding_each_vertex_by_itself():
    # In no order, and different around the sleeve: nothing repeats.
    rest = np.random.default_rng(6).permutation(sleeve())
    values = (0.01 * np.sin(12 * rest @ [[1.0, 0.3, 0.0], [0.5, 1.0, 0.7], [0.0, 2.0, 1.0]])).astype(np.float32)
    hierarchy = VertexHierarchy(encode_rest(rest)[1])
    codes, _ = hierarchy.quantise(values, STEP)
    plain = np.round(values / STEP).astype(np.int32)
    assert len(encode_integers(codes, hierarchy.surroundings)) < 0.8 * len(pack(plain.T))


def test_what_vertices_are_expected_from_comes_before_them():
    order, neighbours = hierarchy().surroundings.order, hierarchy().surroundings.neighbours
    assert np.array_equal(np.sort(order), np.arange(len(sleeve())))
    place = np.argsort(order)
    known = neighbours[order] >= 0
    assert (place[neighbours[order]] < np.arange(len(order))[:, None])[known].all()


def test_vertices_in_one_place_and_single_vertices_are_fine():
    for lattice in (np.zeros((1, 3), np.int32), np.zeros((9, 3), np.int32), np.array([[0, 0, 0], [10**6, 0, 5]])):
        values = np.arange(len(lattice), dtype=np.float32)[:, None]
        codes, decoded = VertexHierarchy(lattice).quantise(values, 0.01)
        assert np.abs(decoded - values).max() < 0.0061
        assert np.array_equal(VertexHierarchy(lattice).restore(codes, 0.01), decoded)


def test_places_outside_the_lattice_are_refused():
    for lattice in (np.full((2, 3), -1), np.full((2, 3), 2**20), np.zeros((0, 3), np.int32)):
        with pytest.raises(ValueError, match="lattice"):
            VertexHierarchy(lattice)


@pytest.mark.parametrize("largest", [0, 1, 100, 127, 128, 30_000, 2**30])
def test_integers_of_any_size_come_back(largest: int):
    values = np.random.default_rng(3).integers(-largest, largest + 1, (7, 11)).astype(np.int32)
    assert np.array_equal(unpack(pack(values), values.shape), values)


def test_packed_integers_are_no_other_number_of_integers():
    packed = pack(np.arange(12))
    for data, shape in ((packed, (11,)), (packed, (13,)), (packed[:-4], (12,)), (b"", (0,)), (b"\x07abc", (3,))):
        with pytest.raises(ValueError):
            unpack(data, shape)


def test_a_small_file_cannot_ask_for_much_memory():
    with pytest.raises(ValueError):
        unpack(pack(np.zeros(10, np.int32)), (10**10,))
