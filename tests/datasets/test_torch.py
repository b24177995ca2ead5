"""Data sets in PyTorch: the same samples whoever draws them, other noise every epoch."""

import os
import pickle
import types
from collections import Counter

import datasets_small as small
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch (the extra `torch`) is not installed")

from slbench import datasets  # noqa: E402
from slbench.core.errors import InputError  # noqa: E402
from slbench.datasets.read import torch_adaptor  # noqa: E402
from slbench.datasets.read.torch_adaptor import CaptureDataset, CaptureStream, loader  # noqa: E402
from slbench.patterns import PatternSequence  # noqa: E402


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return datasets.open_dataset(small.write_dataset(tmp_path_factory.mktemp("data") / "small"))


def fingerprint(items):
    """Return what was drawn, by sample: every pixel of every frame counts."""
    return {int(item["sample"]): item["frames"].numpy().tobytes() for item in items}


def as_worker(monkeypatch, number, count):
    info = types.SimpleNamespace(id=number, num_workers=count)
    monkeypatch.setattr(torch.utils.data, "get_worker_info", lambda: info)
    # What a forked process would be refused for is another test's business.
    monkeypatch.setattr(torch_adaptor, "_checked_process", os.getpid())


class TestItems:
    def test_tensors(self, data):
        captures = CaptureDataset(data, "1,8", seed=5)
        assert len(captures) == len(data)
        item, sample = captures[3], data[3]
        wanted = sample.capture("1,8", seed=captures.recipe.seed_of(sample)).frames
        np.testing.assert_array_equal(item["frames"].numpy(), wanted.astype(np.float32) / 255)
        assert item["frames"].dtype == torch.float32
        truth = sample.truth
        np.testing.assert_array_equal(item["lit"].numpy(), truth.lit)
        np.testing.assert_array_equal(item["instances"].numpy() - 1, truth.object_id)
        lit = truth.lit
        np.testing.assert_array_equal(
            item["panel"].numpy()[:, lit], np.moveaxis(truth.panel, -1, 0)[:, lit].astype("f4")
        )
        assert torch.isfinite(item["depth"]).all()
        assert item["sample"] == sample.number

    def test_twelve_bits_fill_the_same_range(self, data):
        from slbench.detector.emva1288 import Detector

        item = CaptureDataset(data, "white", detector=Detector(bit_depth=12))[0]
        assert 0.5 < float(item["frames"].max()) <= 1.0

    def test_own_items_and_patterns_chosen_for_each_sample(self, data):
        def choose(sample, rng):
            counts = f"1,{rng.integers(4, 20)}"
            return PatternSequence.parse(counts, sample.transport.panel)

        captures = CaptureDataset(data, choose, item=lambda sample, shots: shots.sequence.name)
        names = [captures[k] for k in range(len(data))]
        assert len(set(names)) > 2
        assert names == [captures[k] for k in range(len(data))]

    def test_stored_frames(self, data):
        frames = CaptureDataset(data, None)[0]["frames"]
        np.testing.assert_array_equal(frames, data[0].frames.astype(np.float32) / 255)

    def test_negative_and_outer_positions(self, data):
        captures = CaptureDataset(data, "1")
        assert captures[-1]["sample"] == data[-1].number
        for position in (len(data), -len(data) - 1):
            with pytest.raises(IndexError):
                captures[position]

    def test_kept_samples_are_not_read_again(self, data, monkeypatch):
        captures = CaptureDataset(data, "1", keep=2)
        first = fingerprint([captures[0], captures[1]])
        monkeypatch.setattr("slbench.datasets.store.storage.Storage.read_range", None)
        assert fingerprint([captures[0], captures[1]]) == first
        with pytest.raises(TypeError):
            captures[2]

    def test_kept_samples_stay_in_their_process(self, data):
        captures = CaptureDataset(data, "1", keep=2)
        bare = len(pickle.dumps(captures))
        first = fingerprint([captures[0]])
        content = pickle.dumps(captures)
        assert len(content) <= bare + 100
        assert captures._kept  # it goes on keeping them itself
        assert fingerprint([pickle.loads(content)[0]]) == first

    @pytest.mark.parametrize("options", [{"keep": -1}, {"seed": -1}, {"seed": True}])
    def test_bad_options(self, data, options):
        with pytest.raises(InputError):
            CaptureDataset(data, "1", **options)

    def test_without_torch_it_says_what_to_install(self, data, monkeypatch):
        monkeypatch.setitem(__import__("sys").modules, "torch", None)
        with pytest.raises(InputError, match=r"slbench\[torch\]"):
            CaptureDataset(data, "1")


class TestEpochs:
    def test_noise_follows_from_seed_epoch_and_sample(self, data):
        captures = CaptureDataset(data, "1,8", seed=1)
        zero = fingerprint(captures[k] for k in range(len(data)))
        again = fingerprint(captures[k] for k in reversed(range(len(data))))
        assert again == zero
        captures.set_epoch(1)
        one = fingerprint(captures[k] for k in range(len(data)))
        assert all(one[k] != zero[k] for k in zero)
        captures.set_epoch(0)
        assert fingerprint(captures[k] for k in range(len(data))) == zero
        other = CaptureDataset(data, "1,8", seed=2)
        assert all(fingerprint([other[k]]) != zero for k in range(2))

    def test_a_sample_is_the_same_in_any_selection(self, data):
        whole = fingerprint(CaptureDataset(data, "1,8")[k] for k in range(len(data)))
        part = data.where("height_mm > 3.5")
        some = fingerprint(CaptureDataset(part, "1,8")[k] for k in range(len(part)))
        assert some.items() <= whole.items()

    def test_a_copy_shares_the_epoch_by_pickling_for_processes(self, data):
        captures = CaptureDataset(data, "1")
        captures.set_epoch(4)
        # Plain pickling copies; the epoch comes along.
        assert pickle.loads(pickle.dumps(captures)).epoch == 4

    def test_numpys_whole_numbers_are_epochs(self, data):
        captures = CaptureDataset(data, "1")
        captures.set_epoch(np.int64(3))
        assert captures.epoch == 3

    @pytest.mark.parametrize("epoch", [-1, 1.5, "1", True])
    def test_bad_epochs(self, data, epoch):
        with pytest.raises(InputError, match="epoch"):
            CaptureDataset(data, "1").set_epoch(epoch)


class TestStream:
    @pytest.mark.parametrize("count", [1, 2, 3, 20])
    def test_workers_share_the_samples_out(self, data, monkeypatch, count):
        stream = CaptureStream(data, "1", item=lambda sample, shots: sample.number)
        alone = list(stream)
        parts = []
        for number in range(count):
            as_worker(monkeypatch, number, count)
            parts.append(list(stream))
        assert Counter(x for part in parts for x in part) == Counter(x.number for x in data)
        # Taken in turns, as DataLoader does, in the order of one process.
        turns = [part[k] for k in range(len(data)) for part in parts if k < len(part)]
        assert turns == alone

    def test_a_new_order_every_epoch(self, data):
        stream = CaptureStream(data, "1", item=lambda sample, shots: sample.number)
        orders = []
        for epoch in range(3):
            stream.set_epoch(epoch)
            orders.append(list(stream))
            assert list(stream) == orders[-1]
        assert len(set(map(tuple, orders))) == 3
        straight = CaptureStream(data, "1", shuffle=False, item=lambda x, shots: x.number)
        assert list(straight) == [x.number for x in data]

    def test_an_epoch_that_has_begun_keeps_its_noise(self, data):
        stream = CaptureStream(data, "1,8")
        whole = fingerprint(stream)
        begun = iter(stream)
        first = next(begun)
        stream.set_epoch(7)
        assert fingerprint([first, *begun]) == whole

    def test_map_and_stream_agree(self, data):
        stream = fingerprint(CaptureStream(data, "1,8", seed=3))
        captures = CaptureDataset(data, "1,8", seed=3)
        assert fingerprint(captures[k] for k in range(len(data))) == stream

    def test_batches(self, data):
        batches = list(loader(CaptureStream(data, "1,8"), batch_size=3))
        assert [len(batch["frames"]) for batch in batches] == [3, 3, 2]
        assert batches[0]["frames"].shape == (3, 6, 48, 64)


def test_a_forked_worker_is_refused_where_it_would_be_killed(data):
    import numba

    data[0].capture("1")  # compiled loops have run in this process
    if numba.threading_layer() != "omp":
        pytest.skip("only OpenMP's threads do not survive a fork")
    forked = torch.utils.data.DataLoader(
        CaptureDataset(data, "1"), num_workers=1, multiprocessing_context="fork"
    )
    with pytest.raises(Exception, match="not forked") as caught:
        next(iter(forked))
    assert "exited unexpectedly" not in str(caught.value)


def first_of(batch):
    """Take samples out of batches of one (a function that processes can be sent)."""
    return batch[0]


@pytest.mark.slow
@pytest.mark.parametrize("kind", [CaptureDataset, CaptureStream])
def test_the_same_epochs_whichever_number_of_workers(data, kind):
    def epochs(workers):
        captures = kind(data, "1,8", seed=9)
        loading = loader(captures, batch_size=1, num_workers=workers, collate_fn=first_of)
        result = []
        for epoch in (0, 1, 0):
            captures.set_epoch(epoch)  # the workers of the first epoch live on
            items = list(loading)
            assert len(items) == len(data)
            result.append(fingerprint(items))
        return result

    alone = epochs(0)
    assert alone[0] == alone[2]
    assert all(alone[0][k] != alone[1][k] for k in alone[0])
    assert epochs(1) == alone
    assert epochs(2) == alone


class TestGradients:
    def test_expected_frames_of_a_sample_and_their_gradient(self, data):
        sample = data[1]
        exposure = sample.torch(dtype=torch.float64)
        shown = PatternSequence.parse("1,8@3", sample.transport.panel).shown(np.arange(6), "u")
        values = torch.tensor(shown, requires_grad=True)
        frames = exposure(values, noise=False)
        wanted = sample.capture("1,8@3", noise=False).frames
        off = np.abs(frames.detach().numpy() - wanted)
        # Single precision beside double: a number that ends in a half is rounded either way.
        assert off.max() <= 1.0
        assert np.mean(off > 0) < 1e-2
        frames.sum().backward()
        assert (values.grad.abs().sum(axis=1) > 0).all()
