from .cohort import Cohort as Cohort
from .plan import Condition as Condition
from .plan import UserStudy as UserStudy
from .plan_file import read as read
from .questionnaires import Item as Item
from .questionnaires import Questionnaire as Questionnaire
from .session import StudySession as StudySession
