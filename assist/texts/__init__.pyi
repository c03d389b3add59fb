from .catalogue import Catalogue as Catalogue
from .catalogue import catalogue as catalogue
from .catalogue import languages as languages
