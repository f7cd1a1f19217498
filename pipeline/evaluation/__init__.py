"""The stage `evaluate`: evaluates the policy of a run, or any other policy.

It leaves the results in the folder of the run.
"""
