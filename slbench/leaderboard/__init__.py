"""The leaderboard: frozen scenes, five tasks on them, baselines, and a scorer for predictions.

:mod:`~slbench.leaderboard.frozen` says which scenes, :mod:`~slbench.leaderboard.scenes` what is
known of one, :mod:`~slbench.leaderboard.tasks` what is to be predicted and what an error is,
:mod:`~slbench.leaderboard.board` writes what entrants are given,
:mod:`~slbench.leaderboard.baselines` predicts in closed form,
:mod:`~slbench.leaderboard.predictions` reads folders of predictions, and
:mod:`~slbench.leaderboard.scoring` scores them.
"""
