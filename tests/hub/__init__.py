"""A Hub on loopback that answers the real clients, as far as a release and its readers need.

Contents come by LFS in one piece: the client's other protocol, Xet, has to be switched off
(`HF_HUB_DISABLE_XET=1`).
"""
