"""Light transport matrices: merging, products, marginals and files.  No renderer needed."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st
from sparse_samples import sparse_rows

from slbench.core.errors import InputError
from slbench.simulate.rows import SparseRows
from slbench.simulate.transport import LightTransport

#: float32 has 24 bits; sums of up to 100 terms of one sign in any order.
RTOL = 100 * 2.0**-24


def samples(rows, per_row, width, dtype, seed, zeros=0.2, spread=None):
    """Return random samples; `spread` columns around a random one for each row."""
    rng = np.random.default_rng(seed)
    spread = spread or width
    first = rng.integers(0, width - spread + 1, (rows, 1))
    columns = (first + rng.integers(0, spread, (rows, per_row))).astype(dtype)
    weights = rng.random((rows, per_row)).astype(np.float32)
    weights[rng.random((rows, per_row)) < zeros] = 0.0
    return columns, weights


def test_concatenate_and_scale():
    blocks = [
        replace(rows, differences=0.1 * rows.data)
        for rows in (sparse_rows(*samples(n, 9, 60, np.uint16, seed=n), 60) for n in (5, 1, 30))
    ]
    stacked = scipy.sparse.vstack([block.tocsr() for block in blocks]).toarray()
    whole = SparseRows.concatenate(blocks)
    assert blocks == []  # given up on the way
    np.testing.assert_array_equal(whole.tocsr().toarray(), stacked)
    factors = np.linspace(0.5, 2.0, 36)
    scaled = whole.scaled(factors)
    np.testing.assert_allclose(scaled.tocsr().toarray(), stacked * factors[:, None], rtol=RTOL)
    np.testing.assert_allclose(scaled.differences, 0.1 * scaled.data, rtol=RTOL)


V, U, PANEL = 13, 21, (24, 10)


@pytest.fixture
def transport():
    """All three marginals of the same random samples."""
    rng = np.random.default_rng(3)
    u = rng.integers(0, PANEL[0], (V * U, 40))
    v = rng.integers(0, PANEL[1], (V * U, 40))
    weights = rng.random((V * U, 40)).astype(np.float32) * (rng.random((V * U, 1)) > 0.2)
    marginals = {
        name: sparse_rows(columns.astype(dtype), weights.astype(np.float32), width)
        for name, columns, dtype, width in (
            ("u", u, np.uint16, PANEL[0]),
            ("v", v, np.uint16, PANEL[1]),
            ("uv", v * PANEL[0] + u, np.uint32, PANEL[0] * PANEL[1]),
        )
    }
    ambient = rng.random((V, U)).astype(np.float32)
    return LightTransport(marginals, ambient, PANEL, 40)  # type: ignore[arg-type]


def dense(transport, name):
    return transport.marginals[name].tocsr().toarray().astype(np.float64)


class TestProducts:
    def test_marginals_are_sums(self, transport):
        full = dense(transport, "uv").reshape(V * U, PANEL[1], PANEL[0])
        np.testing.assert_allclose(dense(transport, "u"), full.sum(axis=1), rtol=RTOL)
        np.testing.assert_allclose(dense(transport, "v"), full.sum(axis=2), rtol=RTOL)

    @pytest.mark.parametrize("axis", ["u", "v"])
    @pytest.mark.parametrize("n", [1, 3, 36])
    def test_relight_is_the_dense_product(self, transport, axis, n):
        profiles = np.random.default_rng(n).random((n, PANEL["uv".index(axis)]))
        images = transport.relight(profiles, axis)
        assert images.shape == (n, V, U)
        assert images.dtype == np.float32
        expected = (dense(transport, axis) @ profiles.T).T.reshape(n, V, U) + transport.ambient
        np.testing.assert_allclose(images, expected, rtol=RTOL)

    def test_relight_images_is_the_dense_product(self, transport):
        panels = np.random.default_rng(9).random((5, PANEL[1], PANEL[0]))
        expected = (dense(transport, "uv") @ panels.reshape(5, -1).T).T.reshape(5, V, U)
        images = transport.relight_images(panels)
        np.testing.assert_allclose(images, expected + transport.ambient, rtol=RTOL)

    def test_light_is_linear(self, transport):
        rng = np.random.default_rng(4)
        a, b = rng.random((2, 1, PANEL[0]))
        lit = transport.relight
        left = lit(0.3 * a + 0.7 * b)
        np.testing.assert_allclose(left, 0.3 * lit(a) + 0.7 * lit(b), rtol=2 * RTOL)
        dark = lit(np.zeros((1, PANEL[0])))
        np.testing.assert_array_equal(dark[0], transport.ambient)

    def test_one_lit_pixel_is_one_column(self, transport):
        """Row-major: panel pixel (u, v) is column v W + u."""
        panel = np.zeros((1, PANEL[1], PANEL[0]))
        panel[0, 7, 19] = 1.0
        column = dense(transport, "uv")[:, 7 * PANEL[0] + 19].reshape(V, U)
        seen = transport.relight_images(panel)[0] - transport.ambient
        np.testing.assert_allclose(seen, column, atol=1e-6)
        assert column.any()

    def test_white(self, transport):
        expected = dense(transport, "u").sum(axis=1).reshape(V, U) + transport.ambient
        np.testing.assert_allclose(transport.white(), expected, rtol=RTOL)
        only_v = replace(transport, marginals={"v": transport.marginals["v"]})
        np.testing.assert_allclose(only_v.white(), expected, rtol=RTOL)

    @given(seed=st.integers(0, 1000))
    def test_the_view_from_the_projector_is_the_adjoint(self, seed):
        rng = np.random.default_rng(seed)
        rows = sparse_rows(*samples(V * U, 12, 240, np.uint16, seed), 240)
        value = LightTransport({"uv": rows}, np.zeros((V, U), np.float32), PANEL, 12)
        panel, image = rng.random((PANEL[1], PANEL[0])), rng.random((V, U))
        back = value.view_from_projector(image)
        assert back.shape == (PANEL[1], PANEL[0])
        ahead = np.sum(value.relight_images(panel[None])[0].astype(np.float64) * image)
        assert ahead == pytest.approx(np.sum(back * panel), rel=RTOL)

    def test_batches_cover_all_frames_within_the_budget(self, transport):
        image = 4 * V * U
        for frames, budget in ((36, 10 * image), (36, 1), (7, 1 << 28), (1, image)):
            parts = list(transport.batches(frames, budget))
            covered = [k for part in parts for k in range(frames)[part]]
            assert covered == list(range(frames))
            longest = max(part.stop - part.start for part in parts)
            assert longest == max(1, min(frames, budget // image))


class TestBadInput:
    def test_shapes(self, transport):
        with pytest.raises(InputError, match=r"panel profiles: expected shape \(n, 24\)"):
            transport.relight(np.ones((2, 23)))
        with pytest.raises(InputError, match=r"panel profiles: expected shape \(n, 10\)"):
            transport.relight(np.ones((2, 24)), "v")
        with pytest.raises(InputError, match="panel profiles"):
            transport.relight(np.ones(24))
        with pytest.raises(InputError, match=r"panel images: expected shape \(n, 10, 24\)"):
            transport.relight_images(np.ones((1, 24, 10)))
        with pytest.raises(InputError, match=r"camera image: expected shape \(13, 21\)"):
            transport.view_from_projector(np.ones((21, 13)))

    def test_a_marginal_that_was_not_traced(self, transport):
        only = replace(transport, marginals={"u": transport.marginals["u"]})
        with pytest.raises(InputError, match="light transport: expected the 'v' marginal, got u"):
            only.relight(np.ones((1, 10)), "v")
        with pytest.raises(InputError, match="the 'uv' marginal"):
            only.relight_images(np.ones((1, 10, 24)))
        with pytest.raises(InputError, match="the 'uv' marginal"):
            only.view_from_projector(np.ones((V, U)))


class TestFile:
    @pytest.mark.parametrize("names", [("u",), ("v", "uv"), ("u", "v", "uv")])
    def test_round_trip_keeps_every_byte(self, transport, names, tmp_path):
        kept = replace(transport, marginals={n: transport.marginals[n] for n in names})
        kept.save(tmp_path / "transport.npz")
        back = LightTransport.load(tmp_path / "transport.npz")
        assert (back.panel, back.samples, back.shape) == (PANEL, 40, (V, U))
        assert back.ambient.tobytes() == kept.ambient.tobytes()
        assert set(back.marginals) == set(names)
        for name in names:
            one, two = kept.marginals[name], back.marginals[name]  # type: ignore[index]
            assert one.width == two.width
            for part in ("indptr", "indices", "data"):
                first, second = getattr(one, part), getattr(two, part)
                assert first.dtype == second.dtype
                assert first.tobytes() == second.tobytes()

    def test_the_first_format_is_read(self, transport, tmp_path):
        """Its columns are panel pixels, and its weights are stored as they are."""
        matrix = transport.marginals["u"].tocsr()
        np.savez(
            tmp_path / "transport.npz",
            format=np.array(1),
            panel=np.array(PANEL),
            samples=np.array(40),
            ambient=transport.ambient,
            u_counts=np.diff(matrix.indptr).astype(np.uint8),
            u_indices=matrix.indices.astype(np.uint16),
            u_data=matrix.data.astype(np.float32),
        )
        back = LightTransport.load(tmp_path / "transport.npz")
        panels = np.random.default_rng(0).random((3, PANEL[0]))
        np.testing.assert_allclose(
            back.relight(panels), transport.relight(panels), rtol=1e-5, atol=1e-7
        )

    def test_row_starts_are_as_wide_as_the_entries_need(self, transport, monkeypatch, tmp_path):
        most = transport.marginals["u"].indices.size - 1
        monkeypatch.setattr("slbench.simulate.rows._MOST_INT32", most)
        transport.save(tmp_path / "transport.npz")
        back = LightTransport.load(tmp_path / "transport.npz")
        one, two = transport.marginals["u"], back.marginals["u"]
        assert (one.indptr.dtype, two.indptr.dtype) == (np.int32, np.int64)
        np.testing.assert_array_equal(one.indptr, two.indptr)
        np.testing.assert_array_equal(transport.white(), back.white())

    def test_no_pickles(self, transport, tmp_path):
        transport.save(tmp_path / "transport.npz")
        with np.load(tmp_path / "transport.npz", allow_pickle=False) as archive:
            assert {archive[name].dtype.kind for name in archive.files} <= set("uif")

    @pytest.mark.parametrize("keep", [0.0, 0.3, 0.9, 0.999])
    def test_truncated(self, transport, keep, tmp_path):
        path = tmp_path / "transport.npz"
        transport.save(path)
        path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
        with pytest.raises(InputError) as caught:
            LightTransport.load(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)

    def test_damaged(self, transport, tmp_path):
        path = tmp_path / "transport.npz"
        transport.save(path)
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 0xFF  # the archive has checksums
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"transport\.npz"):
            LightTransport.load(path)

    def test_missing(self, tmp_path):
        with pytest.raises(InputError, match=r"nowhere\.npz"):
            LightTransport.load(tmp_path / "nowhere.npz")

    @pytest.mark.parametrize(
        ("change", "where"),
        [
            ({"format": None}, "format"),
            ({"format": np.array(99)}, "format"),
            ({"format": np.array([1, 1])}, "format"),
            ({"panel": None}, "panel"),
            ({"panel": np.array([24])}, "panel"),
            ({"panel": np.array([24, 10, 3])}, "panel"),
            ({"panel": np.array([-24, 10])}, "panel"),
            ({"samples": None}, "samples"),
            ({"samples": np.array("many")}, "samples"),
            ({"samples": np.array([])}, "samples"),
            ({"ambient": None}, "ambient"),
            ({"ambient": np.zeros(V * U, np.float32)}, "ambient"),
            ({"ambient": np.zeros((V, U + 1), np.float32)}, "u"),
            ({"u_steps": None}, "u"),
            ({"u_data2": None}, "u"),
            ({"u_counts": np.zeros(V * U, np.uint32)}, "u"),
            ({"u_counts": np.zeros(3, np.uint32)}, "u"),
            # Sums that come round to the number of entries.
            ({"u_counts": lambda x: x + np.uint64(2**63) * (np.arange(x.size) < 2)}, "u"),
            ({"u_counts": np.array(["a"] * V * U)}, "u"),
            ({f"u_data{k}": np.zeros(5, np.uint8) for k in range(4)}, "u"),
            ({"u_data1": np.zeros(5, np.uint8)}, "u"),
            ({"u_data1": lambda x: x.astype(np.uint16)}, "u"),
            ({"u_steps": lambda x: x + 24}, "u"),
            ({"u_steps": lambda x: x.astype(np.int16) - 5}, "u"),
            ({"u_steps": lambda x: x.astype(np.float32)}, "u"),
            ({f"u_data{k}": lambda x: x | np.uint8(0xFF) for k in (2, 3)}, "u"),
            ({"u_data0": lambda x: x[:, None]}, "u"),
            ({"format": np.array(1)}, "u"),
            ({"u_counts": None, "v_counts": None, "uv_counts": None}, "marginals"),
        ],
    )
    def test_inconsistent(self, transport, change, where, tmp_path):
        """Every one of these would crash the product, or worse, read outside its arrays."""
        path = tmp_path / "transport.npz"
        transport.save(path)
        with np.load(path) as archive:
            arrays = dict(archive)
        for name, value in change.items():
            arrays[name] = value(arrays[name]) if callable(value) else value
        np.savez(path, **{k: v for k, v in arrays.items() if v is not None})
        with pytest.raises(InputError) as caught:
            LightTransport.load(path)
        line = str(caught.value)
        assert "\n" not in line
        assert str(path) in line
        assert where in line.removeprefix(str(path))
