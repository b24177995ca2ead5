"""Random streams: what a seed means stays, and no two purposes share a stream."""

import itertools

import numpy as np

from slbench.core.random import Word, derived_seed, generator, tagged_seed


def test_words_mean_what_stored_frames_were_drawn_with():
    # NumPy's own derivation, written out: a change of it would change everybody's frames.
    assert generator(7, 2).random() == np.random.default_rng([7, 2]).random()
    assert generator(7).random() == np.random.default_rng(7).random()
    assert derived_seed(7, 4, 1) == np.random.SeedSequence([7, 4, 1]).generate_state(1)[0]


def test_no_purpose_is_zero_or_another_one():
    # A word of zero would be the seed's own stream.
    assert 0 not in list(Word)
    first = {word: generator(5, word).random() for word in Word}
    assert len(set(first.values())) == len(Word)


def test_every_run_of_tags_has_a_seed_of_its_own():
    runs = [tags for n in range(4) for tags in itertools.product((0, 1, 2), repeat=n)]
    assert len({tagged_seed(3, *tags) for tags in runs}) == len(runs)
    assert tagged_seed(3, 1, 2) == tagged_seed(3, 1, 2) != tagged_seed(4, 1, 2)
