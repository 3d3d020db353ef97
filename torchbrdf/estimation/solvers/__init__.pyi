from .quadratic_programs import (
    kkt_residual as kkt_residual,
    lift_above as lift_above,
    project_above as project_above,
    project_nonnegative as project_nonnegative,
)
from .ridge_regression import (
    GramFactor as GramFactor,
    balance as balance,
    prior_mean as prior_mean,
    ridge as ridge,
    ridge_lstsq as ridge_lstsq,
)
