from .contrast import Consequence as Consequence
from .contrast import Contrast as Contrast
from .contrast import contrast as contrast
from .explanation import Explanation as Explanation
from .explanation import Prospect as Prospect
from .explanation import WhyNothing as WhyNothing
from .explanation import WhyPerson as WhyPerson
from .explanation import WhyStep as WhyStep
