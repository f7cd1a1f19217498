"""Grid labyrinths: structures, tasks, dynamics, solver, sampling."""
