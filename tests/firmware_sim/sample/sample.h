/* A package written by hand, as the generator prints them: the harness proves on it that it can fail. */
#ifndef SAMPLE_H
#define SAMPLE_H

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    double k[2];
    double g;
} sample_params;

extern const sample_params sample_params_default;

typedef struct {
    double k[2];
    double twice_g;
} sample_model;

typedef struct {
    double q[2];
    double u[2];
    double tau[2];
    double E_0;
} sample_input;

typedef struct {
    int status;
    int path;
    int rank;
    int sweeps;
    double sigma_min;
    double residual;
} sample_info;

int sample_prepare(const sample_params *params, sample_model *model);

/* S = [k0 u0 + sin q0, k1 u1], z = 2 g q1 - E_0; status -1 where an input is not finite. */
int sample_S_z(const sample_model *model, const sample_input *in, double *S, double *z);
int sample_z(const sample_model *model, const sample_input *in, double *z);

/* tau = S+ z; status 1 or 2 where S = 0. */
int sample_control(const sample_model *model, const sample_input *in, double *tau, sample_info *info);
int sample_project(const sample_model *model, const sample_input *in, double *tau, sample_info *info);
int sample_step(const sample_model *model, const sample_input *in, double dt, double *tau, sample_info *info);
int sample_pinv(const double *S, double *S_pinv, sample_info *info);
int sample_solve(const double *S, const double *z, const double *y, double *tau, sample_info *info);

#ifdef __cplusplus
}
#endif

#endif
