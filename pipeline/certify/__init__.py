"""The stage `certify`: what the splits of data from elsewhere share."""
