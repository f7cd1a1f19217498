"""Labyrinths beside other environments of Gymnasium: how much do episodes vary?"""
