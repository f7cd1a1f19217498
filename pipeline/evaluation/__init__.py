"""The stage `evaluate` for anybody's policy, which `policy=` names."""
