from .advice import Advice as Advice
from .advice import PersonState as PersonState
from .advice import Reason as Reason
from .assistant import Assistant as Assistant
from .problem import InapplicableError as InapplicableError
from .problem import UnknownError as UnknownError
