from .sweeping import sweep as sweep
from .tasks import Task as Task
