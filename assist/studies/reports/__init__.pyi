from .policy_comparison import ComparedPolicy as ComparedPolicy
from .policy_comparison import PolicyComparison as PolicyComparison
from .policy_comparison import compare as compare
from .policy_comparison import comparison_of as comparison_of
from .study_report import Report as Report
from .study_report import write_report as write_report
from .watched_episode import WatchedEpisode as WatchedEpisode
from .watched_episode import watch as watch
