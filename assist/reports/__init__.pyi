from .study_report import Report as Report
from .study_report import write_report as write_report
