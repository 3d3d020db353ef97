from ._reused_columns import Part as Part
from .column_sources import ROW_CELLS as ROW_CELLS, columns_of as columns_of
from .difference import (
    BRDFDifference as BRDFDifference,
    cell_difference as cell_difference,
    delta_e_2000 as delta_e_2000,
)
from .directions import (
    from_half_difference as from_half_difference,
    half_difference as half_difference,
)
from .gram import lower_gram as lower_gram
from .library import MaterialLibrary as MaterialLibrary
from .library_cache import StoredColumns as StoredColumns
from .members import (
    Member as Member,
    library_members as library_members,
)
from .merl import MerlTable as MerlTable, nearest_measured as nearest_measured
from .merl_directory import (
    MERL_MATERIALS as MERL_MATERIALS,
    RESULT as RESULT,
    table_paths as table_paths,
    verify as verify,
)
from .merl_grid import (
    GRID as GRID,
    N_CELLS as N_CELLS,
    above_horizon as above_horizon,
    cell_centres as cell_centres,
    cell_index as cell_index,
)
from .metrics import (
    METRICS as METRICS,
    cell_measure as cell_measure,
    incident_cosine as incident_cosine,
)
from .norms import (
    column_norms as column_norms,
    norm_settings as norm_settings,
)
from .sameness import same_values as same_values, shared_sample as shared_sample
from .settings import (
    METRIC_NAMES as METRIC_NAMES,
    RGL_SUFFIX as RGL_SUFFIX,
    TABLE_SUFFIX as TABLE_SUFFIX,
)
from .tables import read_table as read_table
from .texture import brdf_texture as brdf_texture
