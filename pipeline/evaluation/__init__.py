"""The stage `evaluate`: evaluates the policy of a run, or any other policy."""
