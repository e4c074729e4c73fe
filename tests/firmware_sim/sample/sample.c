#include "sample.h"

#include <math.h>
#include <stddef.h>

const sample_params sample_params_default = {{1.5, -0.5}, 9.81};

int sample_prepare(const sample_params *params, sample_model *model)
{
    model->k[0] = params->k[0];
    model->k[1] = params->k[1];
    model->twice_g = 2.0 * params->g;
    return 0;
}

static int is_finite(const sample_input *in)
{
    const double t0 = in->q[0] + in->q[1] + in->u[0] + in->u[1] + in->E_0;
    return t0 - t0 == 0.0;
}

static int tell(sample_info *info, int status, int rank)
{
    if (info != NULL) {
        info->status = status;
        info->path = 1;
        info->rank = rank;
        info->sweeps = 0;
        info->sigma_min = 0.0;
        info->residual = 0.0;
    }
    return status;
}

int sample_S_z(const sample_model *model, const sample_input *in, double *S, double *z)
{
    if (!is_finite(in)) {
        return -1;
    }
    S[0] = model->k[0] * in->u[0] + sin(in->q[0]);
    S[1] = model->k[1] * in->u[1];
    z[0] = model->twice_g * in->q[1] - in->E_0;
    return 0;
}

int sample_z(const sample_model *model, const sample_input *in, double *z)
{
    double S[2];
    return sample_S_z(model, in, S, z);
}

int sample_pinv(const double *S, double *S_pinv, sample_info *info)
{
    const double t0 = S[0] * S[0] + S[1] * S[1];
    S_pinv[0] = t0 > 0.0 ? S[0] / t0 : 0.0;
    S_pinv[1] = t0 > 0.0 ? S[1] / t0 : 0.0;
    return tell(info, t0 > 0.0 ? 0 : 1, t0 > 0.0 ? 1 : 0);
}

int sample_solve(const double *S, const double *z, const double *y, double *tau, sample_info *info)
{
    double S_pinv[2];
    const int status = sample_pinv(S, S_pinv, info);
    const double y_0 = y != NULL ? y[0] : 0.0;
    const double y_1 = y != NULL ? y[1] : 0.0;
    const double t0 = z[0] - (S[0] * y_0 + S[1] * y_1);
    tau[0] = y_0 + S_pinv[0] * t0;
    tau[1] = y_1 + S_pinv[1] * t0;
    return status;
}

int sample_control(const sample_model *model, const sample_input *in, double *tau, sample_info *info)
{
    double S[2];
    double S_pinv[2];
    double z;
    if (sample_S_z(model, in, S, &z) < 0) {
        return tell(info, -1, 0);
    }
    if (sample_pinv(S, S_pinv, NULL) == 0) {
        tau[0] = S_pinv[0] * z;
        tau[1] = S_pinv[1] * z;
        return tell(info, 0, 1);
    }
    tau[0] = 0.0;
    tau[1] = 0.0;
    return tell(info, z > 0.0 || z < 0.0 ? 2 : 1, 0);
}

int sample_step(const sample_model *model, const sample_input *in, double dt, double *tau, sample_info *info)
{
    double S[2];
    double z;
    if (sample_S_z(model, in, S, &z) < 0) {
        return tell(info, -1, 0);
    }
    tau[0] = in->tau[0] + dt * S[0];
    tau[1] = in->tau[1] + dt * S[1];
    return tell(info, 0, 1);
}

int sample_project(const sample_model *model, const sample_input *in, double *tau, sample_info *info)
{
    return sample_step(model, in, 0.0, tau, info);
}
