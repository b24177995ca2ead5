"""The pictures of a rig design, read through matplotlib's own objects."""

import numpy as np
import pytest
from test_plots import cut_off, overlaps, texts

from slbench.design.rig.evaluate import evaluate
from slbench.design.rig.hardware import load_hardware, own_configuration, read_configurations
from slbench.design.rig.optimise import optimise
from slbench.report.plots.rig_design import few_points, front_figure, rigs_figure
from slbench.scene.file import read_merged

NAME = "hardware/macro-ch6"


@pytest.fixture(scope="module")
def design():
    return optimise(load_hardware(NAME), max_evaluations=3000)


@pytest.fixture(scope="module")
def front(design):
    marked = evaluate(design.hardware, read_configurations("scenes/hardware/table4.csv"))
    own = evaluate(design.hardware, own_configuration(read_merged_of(NAME)))
    return front_figure(design, marked, own)


def read_merged_of(name):
    from slbench.core import resources

    return read_merged(resources.find("scenes", name), False)


def test_axes_are_positive_and_have_words(front):
    labels = texts(front, "label")
    assert len(labels) == 6
    assert {label.split()[0].rstrip(":") for label in labels} == {"error", "coverage", "spacing"}
    # Numbers of all axes: none is negative.
    assert not [text for text in texts(front, "tick") if text.startswith("\N{MINUS SIGN}")]
    assert sum("/ µm" in label for label in labels) == 2
    assert sum("/ mm" in label for label in labels) == 2


def test_numbers_of_clusters_do_not_collide(design, front):
    assert overlaps(front) == []
    assert cut_off(front) == []
    few = few_points(design)
    shown = [str(k) for k, m in enumerate(design.clusters.representatives) if not few[m]]
    # In each of the three panels all that have room, and nearly all have.
    numbers = texts(front, "number")
    assert set(numbers) == set(shown)
    assert len(numbers) > 0.9 * 3 * len(shown)


def test_rigs_that_measure_hardly_anything_are_left_out_and_counted(design, front):
    few = few_points(design)
    assert few.any()
    assert design.evaluation.n_points[few].max() < 0.01 * design.evaluation.n_points.max()
    assert f"{np.count_nonzero(few)} with hardly any points" in texts(front, "title")[0]
    dots = [one for one in front.axes[0].lines if one.get_marker() == "o"]
    assert sum(len(one.get_xdata()) for one in dots) == 3 * np.count_nonzero(~few)


def test_nothing_in_the_picture_is_of_this_run(design, front):
    assert f"{design.seconds:.1f} s" not in " ".join(texts(front, "title"))


def test_a_single_objective_is_drawn_against_the_angle():
    design = optimise(load_hardware(NAME), objectives=["error"], max_evaluations=200)
    labels = texts(front_figure(design), "label")
    assert [label.split()[0] for label in labels] == ["error", "angle"]


def test_rigs_are_drawn_in_one_scale(design):
    drawn = rigs_figure(design)
    views = drawn.axes[1:]
    assert len(views) == 2 * len(design.clusters)
    assert len({(*axes.get_xlim(), *axes.get_ylim()) for axes in views}) == 1
    drawn.canvas.draw()
    box = views[0].get_window_extent()
    (left, right), (low, high) = views[0].get_xlim(), views[0].get_ylim()
    # Equal scales along both axes.
    assert box.width / (right - left) == pytest.approx(box.height / (high - low), rel=1e-6)
    assert overlaps(drawn) == []
