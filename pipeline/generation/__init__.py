"""The generation of datasets: sample, solve, render and write, composed by `build`."""
