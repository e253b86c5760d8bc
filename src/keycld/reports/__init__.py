"""A run's figures and its page: reads stored results, needs neither the model nor its data."""

from keycld.reports.report import write_report as write_report

__all__ = ["write_report"]
