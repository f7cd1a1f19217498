"""The stage `certify`: what the splits of data from elsewhere share.

The data are labyrinths in files or on the Hub, or the levels of anyone's environment.
"""
