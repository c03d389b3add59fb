from .compared_policies import ComparedPolicy as ComparedPolicy
from .compared_policies import PolicyComparison as PolicyComparison
from .compared_policies import comparison_of as comparison_of
from .policy_comparison import compare as compare
from .study_report import Report as Report
from .study_report import write_report as write_report
from .watched_episode import WatchedEpisode as WatchedEpisode
from .watched_episode import watch as watch
