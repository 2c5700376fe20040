"""What the traced integrator draws its samples from: Sobol' points and the tree of the lights."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from light_oracle import Oracle, random_normals
from scipy.stats import qmc
from traced_probes import probe_density, probe_hash, probe_sequence, probe_tree
from traced_scenes import BASIS, NM, lamp_room, soft_room

from usdskin.device import open_workers, vec3
from usdskin.render.domes import DomeLight
from usdskin.render.film import sample_offsets
from usdskin.render.light_guide import PARTS, light_parts, turned_parts
from usdskin.render.light_tree import build_light_tree
from usdskin.render.lights import DistantLight, Lights
from usdskin.render.traced_tile import EDGES
from usdskin.warp_kernels.sampling import DIMENSIONS, direction_numbers


@pytest.fixture(scope="module", autouse=True)
def _warp():
    open_workers("cpu", 1)


def points(keys: np.ndarray, count: int, dimension: int) -> np.ndarray:
    """Coordinates of the first points of many sequences, [keys, count]."""
    out = wp.zeros((len(keys), count), dtype=wp.float32, device="cpu")
    table = wp.array(direction_numbers(), dtype=wp.uint32, device="cpu")
    key = wp.array(keys.astype(np.uint32), dtype=wp.uint32, device="cpu")
    wp.launch(probe_sequence, out.shape, [table, key, dimension, out], device="cpu")
    return out.numpy().astype(np.float64)


# --- Sequences -----------------------------------------------------------------------------------


def test_direction_numbers_are_those_of_joe_and_kuo():
    """Scipy lists the same points in Gray-code order, which changes no prefix of 2^m points."""
    table = direction_numbers().astype(np.uint64)
    count = 1 << 9
    index = np.arange(count, dtype=np.uint64)
    ours = np.zeros((count, DIMENSIONS), np.uint64)
    for bit in range(9):
        ours ^= np.where((index >> np.uint64(bit) & np.uint64(1))[:, None] > 0, table[:, bit], 0)
    gray = (index ^ (index >> np.uint64(1))).astype(int)
    peer = qmc.Sobol(DIMENSIONS, scramble=False, bits=32).random(count)
    np.testing.assert_array_equal(ours[gray] / 2.0**32, peer)


@pytest.mark.parametrize("pair", [(0, 1), (2, 3), (3, 4), (5, 6), (6, 7)])
def test_every_elementary_interval_of_a_pair_holds_its_share(pair):
    """Scrambling keeps a net a net: (0, m, 2) for dimensions 1 and 2, else t of the table's."""
    keys = np.random.default_rng(1).integers(0, 1 << 32, 20)
    for m in (2, 3, 5, 8):
        count = 1 << m
        x, y = (points(keys, count, dimension) for dimension in pair)
        table = direction_numbers()[list(pair)].astype(np.uint64)
        quality = _quality(table, m)
        for split in range(m - quality + 1):
            columns, rows = 1 << split, 1 << (m - quality - split)
            cell = (x * columns).astype(int) * rows + (y * rows).astype(int)
            cell += np.arange(len(keys))[:, None] * columns * rows
            held = np.bincount(cell.ravel(), minlength=len(keys) * columns * rows)
            assert (held == 1 << quality).all()
    assert quality == 0 or pair != (0, 1)


def _quality(table: np.ndarray, m: int) -> int:
    """Return the least t of a digital net in two dimensions, from the rank of its matrices."""
    for t in range(m + 1):
        if all(_independent(table, m, split, m - t - split) for split in range(m - t + 1)):
            return t
    return m


def _independent(table: np.ndarray, m: int, first: int, second: int) -> bool:
    rows = []
    for numbers, count in ((table[0], first), (table[1], second)):
        for digit in range(count):
            bits = [int(numbers[k]) >> (31 - digit) & 1 for k in range(m)]
            rows.append(sum(bit << k for k, bit in enumerate(bits)))
    rank, rows = 0, rows[:]
    while rows:
        pivot = rows.pop()
        if pivot:
            rank += 1
            low = pivot & -pivot
            rows = [row ^ pivot if row & low else row for row in rows]
    return rank == first + second


@pytest.mark.parametrize("dimension", range(8))
def test_any_point_of_the_sequence_is_uniform_over_the_keys(dimension):
    """An unbiased picture needs each sample uniform by itself: chi^2 over 64 cells, 5 sigma."""
    keys = np.arange(40_000)
    x = points(keys, 20, dimension)
    for index in (0, 1, 2, 3, 7, 15, 19):
        held = np.bincount((x[:, index] * 64).astype(int), minlength=64)
        chi2 = ((held - len(keys) / 64) ** 2 / (len(keys) / 64)).sum()
        assert chi2 < 63 + 5 * np.sqrt(2 * 63)
        assert abs(x[:, index].mean() - 0.5) < 5 / np.sqrt(12 * len(keys))


def test_scrambled_means_are_unbiased_and_better_than_random():
    """The mean of x y over 256 points: over keys it is 1/4, its error far below 1/sqrt(256)."""
    keys = np.random.default_rng(5).integers(0, 1 << 32, 4000)
    mean = (points(keys, 256, 2) * points(keys, 256, 3)).mean(axis=1)
    assert abs(mean.mean() - 0.25) < 5 * mean.std() / np.sqrt(len(keys))
    random_error = np.sqrt((1 / 9 - 1 / 16) / 256)
    assert mean.std() < 0.05 * random_error


def test_dimensions_and_keys_are_independent():
    """Correlation of scrambled coordinates over keys stays within 5 / sqrt(count)."""
    keys = np.arange(30_000)
    x = np.stack([points(keys, 3, dimension)[:, 2] for dimension in range(8)])
    x = np.concatenate([x, np.roll(x[:1], 1, axis=1)])  # the neighbouring key
    correlation = np.corrcoef(x) - np.eye(len(x))
    assert np.abs(correlation).max() < 5 / np.sqrt(len(keys))


def test_one_bit_of_the_key_changes_half_of_the_hash():
    random = np.random.default_rng(2)
    a = random.integers(0, 1 << 32, 20_000).astype(np.uint32)
    b = random.integers(0, 4096, len(a)).astype(np.uint32)
    base = hashed(a, b)
    for bit in range(32):
        for changed in (hashed(a ^ np.uint32(1 << bit), b), hashed(a, b ^ np.uint32(1 << bit))):
            flips = np.unpackbits((base ^ changed).view(np.uint8)).reshape(len(a), 32)
            assert np.abs(flips.mean(axis=0) - 0.5).max() < 0.03


def hashed(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    out = wp.zeros(len(a), dtype=wp.uint32, device="cpu")
    inputs = [wp.array(x, dtype=wp.uint32, device="cpu") for x in (a, b)]
    wp.launch(probe_hash, len(a), [*inputs, out], device="cpu")
    return out.numpy()


# --- The tree of the lights ----------------------------------------------------------------------


def turned(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.array(
        [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]
    )


def dome(coefficients: np.ndarray, to_world: np.ndarray | None = None) -> DomeLight:
    rank = coefficients.shape[2]
    return DomeLight(
        path="/Dome",
        coefficients=coefficients.astype(np.float32),
        basis=np.tile(BASIS, (2, 1))[:rank],
        to_world=np.eye(3) if to_world is None else to_world,
        absolute=True,
    )


def tree_of(domes: list[DomeLight], distants: tuple[DistantLight, ...] = ()) -> object:
    groups = sum(-(-d.coefficients.shape[2] // 4) for d in domes) + -(-len(distants) // 4)
    return build_light_tree(Lights(tuple(domes), distants), np.ones((groups, 4)), "cpu")


def density(tree, index, normals, wrap, mix, texels) -> np.ndarray:
    out = wp.zeros((len(normals), texels), dtype=wp.float32, device="cpu")
    inputs = [tree, index, vec3(normals, "cpu"), wrap, mix, out]
    wp.launch(probe_density, out.shape, inputs, device="cpu")
    return out.numpy().astype(np.float64)


def draw(tree, normals, wrap, mix, count, group=0, seed=0) -> dict[str, np.ndarray]:
    u = qmc.Sobol(3, seed=seed).random(count).astype(np.float32) * np.float32(0.9999999)
    shape = (len(normals), count)
    types = {"direction": wp.vec3f, "scale": wp.float32, "density": wp.vec2f, "texel": wp.vec3i,
             "light": wp.vec4f}  # fmt: skip
    out = {name: wp.zeros(shape, dtype=kind, device="cpu") for name, kind in types.items()}
    inputs = [tree, vec3(normals, "cpu"), wrap, mix, group, vec3(u, "cpu"), *out.values()]
    wp.launch(probe_tree, shape, inputs, device="cpu")
    return {name: values.numpy().astype(np.float64) for name, values in out.items()}


def solid_angles(height: int, width: int) -> np.ndarray:
    return (-np.diff(np.cos(np.pi * np.arange(height + 1) / height)) * 2 * np.pi / width).repeat(
        width
    )


def dotted(height: int = 16) -> np.ndarray:
    """Black but for some texels: one small lamp, one at the pole, one row."""
    found = np.zeros((height, 2 * height, 3))
    found[3, 7] = [50.0, 20.0, 1.0]
    found[0, 5] = [1.0, 3.0, 1.0]
    found[11] = 0.2
    return found


MAPS = pytest.mark.parametrize(
    "coefficients",
    [soft_room(16), lamp_room(32), dotted(), np.ones((1, 2, 3)), np.ones((2, 3, 1))],
    ids=["soft", "lamp", "dotted", "one row", "two rows"],
)
SURFACES = pytest.mark.parametrize(
    ("wrap", "mix"), [(0.0, 0.0), (0.0, 0.4), (0.3, 0.4), (1.0, 0.4)]
)


@MAPS
@SURFACES
def test_chances_sum_to_at_most_one_and_reach_every_texel_that_gives_light(coefficients, wrap, mix):
    normals = np.concatenate([random_normals(40, 1), np.eye(3), -np.eye(3)])
    tree = tree_of([dome(coefficients)])
    height, width = coefficients.shape[:2]
    angle = solid_angles(height, width)
    found = density(tree, 0, normals, wrap, mix, height * width)
    total = found @ angle
    is_black = coefficients.max(axis=2).ravel() == 0.0
    # A walk may end where both children of a node lie behind the surface: it gives nothing.
    assert total.max() < 1.0 + 2e-5
    assert total[total > 0.0].mean() > 0.85
    assert (found[:, is_black] == 0.0).all()
    # The corners and the middle of every texel: what any of them lights has to have a chance.
    i, j = np.divmod(np.arange(height * width), width)
    for down in (0.01, 0.5, 0.99):
        for across in (0.01, 0.5, 0.99):
            polar, turn = np.pi * (i + down) / height, 2 * np.pi * (j + across) / width
            toward = np.stack(
                [np.sin(polar) * np.sin(turn), np.cos(polar), -np.sin(polar) * np.cos(turn)], -1
            )
            x = normals @ toward.T
            lit = np.maximum(x, 0.0) + mix * np.maximum(x + wrap, 0.0) > 1e-6
            assert (found[lit & ~is_black] > 0.0).all()


@MAPS
@SURFACES
def test_samples_follow_the_density_that_is_told(coefficients, wrap, mix):
    normals = random_normals(6, 3)
    tree = tree_of([dome(coefficients, turned(0.7))])
    height, width = coefficients.shape[:2]
    drawn = draw(tree, normals, wrap, mix, 1 << 14)
    ok = drawn["scale"] > 0.0
    np.testing.assert_allclose(
        drawn["density"][..., 0][ok], drawn["density"][..., 1][ok], rtol=1e-4
    )
    np.testing.assert_allclose(drawn["scale"][ok] * drawn["density"][..., 0][ok], 1.0, rtol=1e-5)
    # float32 may put a direction on the seam of two texels into either.
    same = drawn["texel"][..., 1][ok] == drawn["texel"][..., 2][ok]
    assert same.mean() > 0.999
    expected = density(tree, 0, normals, wrap, mix, height * width) * solid_angles(height, width)
    for n in range(len(normals)):
        held = np.bincount(drawn["texel"][n, ok[n], 1].astype(int), minlength=height * width) / (
            1 << 14
        )
        assert np.abs(held - expected[n]).sum() < 0.15
        assert np.abs(held - expected[n]).max() < 0.005


@pytest.mark.parametrize("coefficients", [soft_room(16), lamp_room(32)], ids=["soft", "lamp"])
@pytest.mark.parametrize("wrap", [0.0, 0.3, 1.0])
def test_samples_times_kernel_are_the_map(coefficients, wrap):
    """Unbiased for Lambert and wrap alike: 2^15 points meet the float64 integrals to 0.2 %."""
    normals = random_normals(8, 9)
    turn = turned(1.1)
    drawn = draw(tree_of([dome(coefficients, turn)]), normals, wrap, 0.4, 1 << 15)
    oracle = Oracle(coefficients, turn)
    x = np.einsum("nk,nik->ni", normals, drawn["direction"])
    for lobe in (0.0, wrap):
        kernel = np.maximum((x + lobe) / (1.0 + lobe), 0.0)
        found = (kernel[..., None] * drawn["light"]).mean(axis=1)[:, :3]
        exact = oracle.integrate(normals, lobe)
        assert np.abs(found / exact - 1.0).max() < 4e-3
        assert abs((found / exact).mean() - 1.0) < 1e-3


def test_two_domes_and_distant_lights_share_one_tree():
    """Each gives what it gives alone: a lamp of 10 degrees and a parallel one among two domes."""
    sun = np.array([0.3, 0.8, 0.52])
    distants = tuple(
        DistantLight(
            path=f"/Sun{k}",
            direction=sun * sign,
            angle_deg=angle,
            irradiance=np.ones(len(NM)),
            absolute=True,
        )
        for k, (sign, angle) in enumerate([([1.0, 1.0, 1.0], 10.0), ([-1.0, 1.0, 1.0], 0.0)])
    )
    maps = [soft_room(16), np.concatenate([lamp_room(32)] * 2, axis=2)[..., :5]]
    domes = [dome(maps[0]), dome(maps[1], turned(0.5))]
    tree = tree_of(domes, distants)
    normals = random_normals(6, 2)
    seen = []
    for group in range(4):
        drawn = draw(tree, normals, 0.3, 0.4, 1 << 16, group)
        x = np.maximum(np.einsum("nk,nik->ni", normals, drawn["direction"]), 0.0)
        seen.append((x[..., None] * drawn["light"]).mean(axis=1))
    exact = [Oracle(maps[0], np.eye(3)), Oracle(maps[1], turned(0.5))]
    peak = 20.0
    assert np.abs(seen[0][:, :3] - exact[0].integrate(normals, 0.0)).max() < 1e-2 * peak
    five = np.concatenate([seen[1], seen[2][:, :1]], axis=1)
    assert np.abs(five - exact[1].integrate(normals, 0.0)).max() < 1e-2 * peak
    axis = np.stack([d.direction / np.linalg.norm(d.direction) for d in distants])
    facing = np.maximum(normals @ axis.T, 0.0)
    clear = np.abs(normals @ axis.T) > 0.1
    assert np.abs(seen[3][:, :2] - facing)[clear].max() < 2e-2


# --- The parts of the light that blocks learn of -----------------------------------------------


def test_moments_of_the_parts_are_the_lights_own():
    """Vector irradiance and flux by a sum over texels; a facing distant lamp gives 1."""
    map_, turn = lamp_room(64), turned(0.8)
    sun = DistantLight(
        path="/Sun", direction=np.array([0.3, 0.8, 0.52]), angle_deg=10.0,
        irradiance=np.ones(len(NM)), absolute=True,
    )  # fmt: skip
    lights = Lights((dome(map_, turn),), (sun,))
    tree = build_light_tree(lights, np.ones((2, 4)), "cpu")
    parts = light_parts(lights, tree, 2, "cpu")
    assert len(parts.moments) == min(PARTS, tree.leaf_node.shape[0])
    fine = 16  # directions along each side of a texel
    height, width, channels = map_.shape
    polar = np.pi * (np.arange(height * fine) + 0.5) / (height * fine)
    azimuth = 2.0 * np.pi * (np.arange(width * fine) + 0.5) / (width * fine)
    angle = np.sin(polar)[:, None] * (np.pi / (height * fine)) * (2.0 * np.pi / (width * fine))
    up, around = np.meshgrid(polar, azimuth, indexing="ij")
    toward = np.stack(
        [np.sin(up) * np.sin(around), np.cos(up), -np.sin(up) * np.cos(around), np.ones_like(up)]
    )
    weight = (toward * angle).reshape(4, height, fine, width, fine).sum(axis=(2, 4))
    exact = np.einsum("khw,hwc->kc", weight, map_)
    exact[:3] = turn @ exact[:3]
    total = parts.moments.sum(axis=0)
    scale = np.abs(exact[3]).max()
    assert np.abs(total[0][:, :channels] - exact).max() < 2e-4 * scale
    axis = sun.direction / np.linalg.norm(sun.direction)
    np.testing.assert_allclose(total[1][:3, 0], axis, atol=1e-6)
    again = turned_parts(parts, np.eye(3), "cpu").moment.numpy()
    np.testing.assert_allclose(again, parts.moment.numpy(), atol=1e-6 * scale)


def test_parts_hold_every_leaf_once():
    tree = tree_of([dome(soft_room(16)), dome(lamp_room(32))])
    lights = Lights((dome(soft_room(16)), dome(lamp_room(32))), ())
    parts = light_parts(lights, tree, 2, "cpu")
    node, above = parts.node.numpy(), tree.node_parent.numpy()
    for leaf, part in enumerate(parts.leaf_part.numpy()):
        at = tree.leaf_node.numpy()[leaf]
        chain = {int(at)}
        while above[at] >= 0:
            at = above[at]
            chain.add(int(at))
        assert chain & set(node.tolist()) == {int(node[part])}
    flux = tree.node_flux.numpy()
    np.testing.assert_allclose(flux[node].sum(), flux[0], rtol=1e-5)


# --- Edges ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [4, 8, 16, 64])
def test_what_lattices_miss_of_an_edge_is_what_the_spread_of_their_samples_says(count: int):
    """Half planes across a pixel: squared error of the share covered, against its exact value."""
    random = np.random.default_rng(count)
    turns, ways = random.uniform(0.0, 2.0 * np.pi, 2000), random.uniform(-0.6, 0.6, 2000)
    across = np.stack([np.cos(turns), np.sin(turns)])
    covered = (sample_offsets(count, "box") @ across < ways).astype(float)
    place = (np.arange(100) + 0.5) / 100 - 0.5
    fine = np.stack(np.meshgrid(place, place), axis=-1).reshape(-1, 2)
    exact = np.array([(fine @ way < end).mean() for way, end in zip(across.T, ways, strict=True)])
    error = ((covered.mean(axis=0) - exact) ** 2).mean()
    told = EDGES * covered.var(axis=0, ddof=1).mean() * count**-1.5
    assert 0.7 < told / error < 1.3
