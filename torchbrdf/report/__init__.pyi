from ._description import (
    held_by_library as held_by_library,
    in_words as in_words,
)
from ._silhouette_section import Scene as Scene
from .comparison import Comparison as Comparison
from .comparison_page import write_comparison as write_comparison
from .doubts import (
    Doubt as Doubt,
    doubts_of_result as doubts_of_result,
    doubts_without_pictures as doubts_without_pictures,
    few_pixels as few_pixels,
)
from .evidence import Subject as Subject
from .grade import Grade as Grade
from .page import (
    plate as plate,
    source_hash as source_hash,
)
from .report import (
    Verdict as Verdict,
    write_report as write_report,
)
from .settings import (
    COMPARISON_SAMPLES as COMPARISON_SAMPLES,
    COMPARISON_SIZE as COMPARISON_SIZE,
)
from .style import (
    LIVE_STYLE as LIVE_STYLE,
)
