"""Figures, drawn with matplotlib; which function draws what.

A value that has a picture asks :mod:`slbench.core.show.drawing` for it, which finds the row of its
type here: the value does not import how it is drawn.
"""

#: Type of the value -> function that draws it into a matplotlib figure, by dotted names.
DRAWERS: dict[str, str] = {
    "slbench.rig.rig:Rig": "slbench.report.plots.draw:rig_figure",
    "slbench.patterns.sequence:PatternSequence": "slbench.report.plots.stream:patterns",
    "slbench.capture.capture:Capture": "slbench.report.plots.stream:frames",
    "slbench.capture.stack:FocusStack": "slbench.report.plots.stream:stack",
    "slbench.capture.fusion.photographs:FusedPhotographs": "slbench.report.plots.stream:fused",
    "slbench.patterns.decode:PhaseMap": "slbench.report.plots.stream:phase_map",
    "slbench.cloud.joint:JointCloud": "slbench.report.plots.stream:joint_cloud",
    "slbench.cloud.triangulation:PointCloud": "slbench.report.plots.stream:cloud",
    "slbench.simulate.scan:Scan": "slbench.report.plots.scan:summary",
    "slbench.simulate.several.scan:RigScan": "slbench.report.plots.rig_scan:summary",
    "slbench.score.clouds.cloudscore:CloudScore": "slbench.report.plots.cloudscore:draw",
    "slbench.twin.twin:Twin": "slbench.report.plots.twin:draw",
    "slbench.bench.compare.comparison:Comparison": "slbench.report.pages.compare:draw",
    "slbench.bench.accept.acceptance:Acceptance": "slbench.report.plots.acceptance:draw",
    "slbench.bench.budget.budget:Budget": "slbench.report.plots.budget:draw",
    "slbench.bench.budget.result:UncertaintyBudget": "slbench.report.plots.uncertainty:draw",
    "slbench.bench.terms.terms:Terms": "slbench.report.plots.terms:draw",
    "slbench.bench.diagnose.diagnosis:Diagnosis": "slbench.report.plots.diagnose:draw",
    "slbench.bench.sweep.sweep:Sweep": "slbench.report.plots.sweep:draw",
    "slbench.design.views.plan:ViewPlan": "slbench.report.plots.views:draw_plan",
    "slbench.simulate.viewpoints.scan:ScannedViews": "slbench.report.plots.views:draw_scanned",
}
