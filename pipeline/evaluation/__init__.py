"""The stage `evaluate`: what a policy achieves, that of a run or any other."""
