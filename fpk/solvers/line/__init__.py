"""Stationary FPK equation of one energy: hp elements, certified; the kinds of its boundaries."""
