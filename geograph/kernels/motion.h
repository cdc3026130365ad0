/* Transitions of a path under white noise, and free fall with its derivatives (motion.py, falls.py). */

/* Transitions under white noise whose density is that of the axes; scaled: inverse transitions,
   roots of the noise, and whitened residuals of a path. */
WIDE static void kinematics_all(Size count, Size order, const double *unit_root,
                                const double *density, const double *scale, const double *steps,
                                const double *state, double *inverse, double *root,
                                double *residual)
{
    Size m = 3 * order;
    for (Size k = 0; k < count; k++) {
        double step = steps[k], power[MOST_ORDER], taylor[MOST_ORDER];
        for (Size i = 0; i < order; i++) {
            power[i] = pow(step, (double)(order - i) - 0.5);
            taylor[i] = pow(step, (double)i) / FACTORIAL[i];
        }
        if (inverse != NULL)
            for (Size i = 0; i < order; i++)
                for (Size j = i; j < order; j++)
                    for (Size axis = 0; axis < 3; axis++) {
                        Size row = 3 * i + axis, column = 3 * j + axis;
                        double back = (j - i) % 2 ? -taylor[j - i] : taylor[j - i];
                        inverse[(k * m + row) * m + column] = back * scale[column] / scale[row];
                    }
        if (root != NULL)
            for (Size i = 0; i < order; i++)
                for (Size j = 0; j <= i; j++)
                    for (Size axis = 0; axis < 3; axis++) {
                        Size row = 3 * i + axis, column = 3 * j + axis;
                        root[(k * m + row) * m + column] =
                            power[i] * unit_root[i * order + j] * density[axis] / scale[row];
                    }
        const double *now = state + k * m, *next = now + m;
        for (Size axis = 0; axis < 3; axis++) {
            double miss[MOST_ORDER];
            for (Size i = 0; i < order; i++) {
                double gap = next[3 * i + axis];
                for (Size j = i; j < order; j++)
                    gap -= taylor[j - i] * now[3 * j + axis];
                gap /= power[i];
                for (Size j = 0; j < i; j++)
                    gap -= unit_root[i * order + j] * miss[j];
                miss[i] = gap / unit_root[i * order + i];
                residual[k * m + 3 * i + axis] = miss[i] / density[axis];
            }
        }
    }
}

static PyObject *kinematics(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size count = whole(&reader), order = whole(&reader);
    if (!reader.failed && (order < 1 || order > MOST_ORDER)) {
        PyErr_SetString(PyExc_ValueError, "expected 1 to 3 blocks");
        reader.failed = 1;
    }
    Size m = 3 * order;
    const double *unit_root = reals(&reader, order * order);
    const double *density = reals(&reader, 3);
    const double *scale = reals(&reader, m);
    const double *steps = reals(&reader, count);
    const double *state = reals(&reader, (count + 1) * m);
    double *inverse = results(&reader, count * m * m);
    double *root = results(&reader, count * m * m);
    double *residual = results(&reader, count * m);
    if (!complete(&reader, unit_root && density && scale && steps && state && residual)) {
        release(&reader);
        return NULL;
    }
    Py_BEGIN_ALLOW_THREADS
    kinematics_all(count, order, unit_root, density, scale, steps, state, inverse, root, residual);
    Py_END_ALLOW_THREADS
    release(&reader);
    Py_RETURN_NONE;
}


/* The Earth, as geograph.constants has it. */
typedef struct {
    double mass, j2, j3, j4, radius, spin;
} Earth;

/* factors/gravity.py: acceleration, in ECEF axes, with its derivative by the position; that by the
   velocity is 2 spin (e_x e_y' - e_y e_x'). */
INLINE void pull(const Earth *earth, int degree, const double *p, const double *v, double *value,
                 double by[3][3])
{
    double z = p[2], r2 = dot(p, p), r = sqrt(r2), spin2 = earth->spin * earth->spin;
    double mass = earth->mass / (r2 * r);
    double k = 1.5 * earth->j2 * earth->radius * earth->radius * earth->mass / (r2 * r2 * r);
    double ratio = 5.0 * z * z / r2, radial = -mass - k * (1.0 - ratio);
    double slope = (3.0 * mass + 5.0 * k * (1.0 - ratio) - 2.0 * k * ratio) / r2;
    double tilt = 10.0 * k * z / r2;
    value[0] = radial * p[0] + 2.0 * earth->spin * v[1] + spin2 * p[0];
    value[1] = radial * p[1] - 2.0 * earth->spin * v[0] + spin2 * p[1];
    value[2] = radial * z - 2.0 * k * z;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            by[i][j] = p[i] * (slope * p[j] + (j == 2 ? tilt : 0.0)) + (i == j ? radial : 0.0);
    for (int j = 0; j < 3; j++)
        by[2][j] += tilt * p[j];
    by[2][2] -= 2.0 * k;
    by[0][0] += spin2;
    by[1][1] += spin2;
    if (degree != 4)
        return;
    double u[3] = {p[0] / r, p[1] / r, p[2] / r}, s = u[2], s2 = s * s;
    double turn[3] = {-s * u[0], -s * u[1], 1.0 - s * u[2]};
    /* Of P'(n+1), P''(n+1), P'n, P''n for n = 3 and 4. */
    const double third[2] = {(35.0 * s2 * s - 15.0 * s) / 2.0, (105.0 * s2 - 15.0) / 2.0};
    const double second[2] = {(15.0 * s2 - 3.0) / 2.0, 15.0 * s};
    const double fourth[2] = {(315.0 * s2 * s2 - 210.0 * s2 + 15.0) / 8.0,
                              (315.0 * s2 * s - 105.0 * s) / 2.0};
    for (int n = 3; n <= 4; n++) {
        const double *a = n == 3 ? third : fourth, *b = n == 3 ? second : third;
        double share = earth->radius / r;
        double size = earth->mass / r2 * (n == 3 ? earth->j3 : earth->j4) * share * share * share *
                      (n == 3 ? 1.0 : share);
        for (int i = 0; i < 3; i++)
            value[i] += size * a[0] * u[i];
        value[2] -= size * b[0];
        size /= r;
        for (int j = 0; j < 3; j++) {
            double outward = size * (a[1] * turn[j] - (n + 3) * a[0] * u[j]);
            for (int i = 0; i < 3; i++)
                by[i][j] += (i == j ? size * a[0] : 0.0) + u[i] * outward;
            by[2][j] -= size * (b[1] * turn[j] - (n + 2) * b[0] * u[j]);
        }
    }
}

/* Rates of the state and of its derivative by the given state, 6 and 6 x 6. */
INLINE void fall_rates(const Earth *earth, int degree, const double *x, const double *phi,
                       double *rate, double *phi_rate)
{
    double by[3][3];
    memcpy(rate, x + 3, sizeof(double) * 3);
    pull(earth, degree, x, x + 3, rate + 3, by);
    memcpy(phi_rate, phi + 18, sizeof(double) * 18);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 6; j++)
            phi_rate[18 + 6 * i + j] =
                by[i][0] * phi[j] + by[i][1] * phi[6 + j] + by[i][2] * phi[12 + j];
    for (int j = 0; j < 6; j++) {
        phi_rate[18 + j] += 2.0 * earth->spin * phi[24 + j];
        phi_rate[24 + j] -= 2.0 * earth->spin * phi[18 + j];
    }
}

#define FALLING 42

/* One fall by classical Runge-Kutta steps of fourth order; y is the state and its derivative. */
WIDE static void fall_all(const Earth *earth, int degree, Size n, Size parts, const double *state,
                          const double *steps, double *after, double *derivative)
{
    static const double at[4] = {0.0, 0.5, 0.5, 1.0}, share[4] = {1.0, 2.0, 2.0, 1.0};
    for (Size i = 0; i < n; i++) {
        double y[FALLING] = {0.0}, h = steps[i] / (double)parts;
        memcpy(y, state + 6 * i, sizeof(double) * 6);
        for (int j = 0; j < 6; j++)
            y[6 + 7 * j] = 1.0;
        for (Size part = 0; part < parts; part++) {
            double rate[FALLING] = {0.0}, sum[FALLING] = {0.0}, now[FALLING];
            for (int stage = 0; stage < 4; stage++) {
                for (int j = 0; j < FALLING; j++)
                    now[j] = y[j] + at[stage] * h * rate[j];
                fall_rates(earth, degree, now, now + 6, rate, rate + 6);
                for (int j = 0; j < FALLING; j++)
                    sum[j] += share[stage] * rate[j];
            }
            for (int j = 0; j < FALLING; j++)
                y[j] += h / 6.0 * sum[j];
        }
        memcpy(after + 6 * i, y, sizeof(double) * 6);
        memcpy(derivative + 36 * i, y + 6, sizeof(double) * 36);
    }
}

static PyObject *fall(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size n = whole(&reader), parts = whole(&reader), degree = whole(&reader);
    if (!reader.failed && (parts < 1 || (degree != 2 && degree != 4))) {
        PyErr_SetString(PyExc_ValueError, "expected one step at least, and the degree 2 or 4");
        reader.failed = 1;
    }
    const double *earth = reals(&reader, 6);
    const double *state = reals(&reader, 6 * n);
    const double *steps = reals(&reader, n);
    double *after = results(&reader, 6 * n);
    double *derivative = results(&reader, 36 * n);
    if (!complete(&reader, earth && state && steps && after && derivative)) {
        release(&reader);
        return NULL;
    }
    Earth own = {earth[0], earth[1], earth[2], earth[3], earth[4], earth[5]};
    Py_BEGIN_ALLOW_THREADS
    fall_all(&own, (int)degree, n, parts, state, steps, after, derivative);
    Py_END_ALLOW_THREADS
    release(&reader);
    Py_RETURN_NONE;
}
