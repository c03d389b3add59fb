from .catalogue import Catalogue as Catalogue
from .catalogue import catalogue as catalogue
from .catalogue import languages as languages
from .refusals import AbsentError as AbsentError
from .refusals import InapplicableError as InapplicableError
from .refusals import Refusal as Refusal
