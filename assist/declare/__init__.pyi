from .declared import DeclarationError as DeclarationError
from .declared import declared as declared
from .declared import plain as plain
