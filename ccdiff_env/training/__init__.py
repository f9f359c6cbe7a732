"""Learners: networks of traffic, egos, choices of adversaries; environments know none of them."""
