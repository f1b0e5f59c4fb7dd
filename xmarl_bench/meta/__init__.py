"""Tests of the metrics: do they measure what they claim, on known truth and on degraded rankings?"""
