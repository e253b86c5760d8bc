"""Figures and pages of runs and suites, from stored results; they need neither the model nor its data."""

from keycld.reports.control_figures import write_control_media as write_control_media
from keycld.reports.live_page import live_page as live_page
from keycld.reports.priors_report import write_priors_report as write_priors_report
from keycld.reports.report import write_report as write_report
from keycld.reports.suite_report import write_suite_report as write_suite_report

__all__ = ["live_page", "write_control_media", "write_report", "write_priors_report", "write_suite_report"]
