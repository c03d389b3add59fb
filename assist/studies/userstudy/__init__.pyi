from .cohort import Cohort as Cohort
from .forms import Item as Item
from .plan import Condition as Condition
from .plan import UserStudy as UserStudy
from .plan_file import read as read
from .questionnaires import Questionnaire as Questionnaire
from .session import StudySession as StudySession
