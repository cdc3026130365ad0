/* Bearings with their derivatives (families/bearings.py, factors/bearing.py, factors/light_time.py). */

/* Channels of error, as geograph.states has them; the module exports them to be checked. */
enum { AZIMUTH = 0, ELEVATION = 1, CLOCK = 2, POSITION = 3, VELOCITY = 6, SPEED = 10, CHANNELS = 14 };

typedef struct {
    Size n, knots, order, e, s, f, walks, poses;
    const double *knots_s, *basis, *hermite;
    const int64_t *pose; /* of each bearing: the row of the four that follow */
    const double *sensor_m, *axes, *sensor_velocity, *axes_rate, *received_s;
    const double *azimuth, *elevation, *turned, *tangent, *white;
    double speed_m_s, spin_rad_s, enough_s;
    int clocked, fast, noisy, rounds;
    double *light_time_s, *residual, *time_s, *weights, *by_position, *by_constants;
    int64_t *interval;
    const int64_t *constant_row, *constant_channel, *constant_column;
    const double *constant_basis, *constants;
    const int64_t *walk_row, *walk_channel, *walk_column;
    const double *walk_basis, *walk_time, *chains;
    double *walk_before, *walk_after, *by_walks;
    const Size *first, *entry, *first_walk, *entry_walk;
} Bearings;

INLINE double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static const double FACTORIAL[2 * MOST_ORDER] = {1.0, 1.0, 2.0, 6.0, 24.0, 120.0};

/* factors/kinematics.py: interpolation_weights, of position and velocity; without the latter where
   it is not asked for. */
INLINE void weights(Size order, int moving, const double *hermite, double step, double offset,
                    double *position, double *velocity)
{
    Size size = 2 * order;
    double each = 1.0 / step, s = offset * each;
    if (s < 0.0 || s > 1.0) {
        Size first = s < 0.0 ? 0 : order;
        double since = s < 0.0 ? offset : offset - step, power = 1.0;
        memset(position, 0, sizeof(double) * (size_t)size);
        memset(velocity, 0, sizeof(double) * (size_t)size);
        for (Size block = 0; block < order; block++) {
            position[first + block] = power / FACTORIAL[block];
            if (block + 1 < order)
                velocity[first + block + 1] = power / FACTORIAL[block];
            power *= since;
        }
        return;
    }
    double powers[2 * MOST_ORDER], unit = 1.0;
    powers[0] = 1.0;
    for (Size power = 1; power < size; power++)
        powers[power] = powers[power - 1] * s;
    for (Size block = 0; block < order; block++, unit *= step)
        for (Size knot = 0; knot < 2; knot++) {
            Size row = knot * order + block;
            const double *by = hermite + row * size;
            double value = by[0], slope = 0.0;
            for (Size power = 1; power < size; power++) {
                value += by[power] * powers[power];
                if (moving)
                    slope += by[power] * (double)power * powers[power - 1];
            }
            position[row] = value * unit;
            if (moving)
                velocity[row] = slope * unit * each;
        }
}

/* The interval that a time lies in, clipped to the first and the last; searched from a guess. */
static inline Size find(const double *knots_s, Size knots, double time, Size guess)
{
    Size last = knots - 2;
    if (guess > last)
        guess = last;
    if (time >= knots_s[guess] || guess == 0) {
        if (guess == last || time < knots_s[guess + 1])
            return guess;
    }
    Size low = 0, high = knots; /* the first knot after the time is in (low, high] */
    while (low < high) {
        Size middle = (low + high) / 2;
        if (knots_s[middle] <= time)
            low = middle + 1;
        else
            high = middle;
    }
    Size found = low - 1;
    return found < 0 ? 0 : found > last ? last : found;
}

typedef struct {
    double line[3], distance, light_time, velocity[3], inertial[3];
} Sight;

/* factors/light_time.py: sight. */
INLINE Sight look(const double *at, const double *velocity, const double *sensor,
                         double light_time, double spin)
{
    Sight found;
    double turned[3] = {at[0], at[1], at[2]};
    memcpy(found.velocity, velocity, sizeof found.velocity);
    if (spin != 0.0) {
        double sine = sin(spin * light_time), cosine = cos(spin * light_time);
        turned[0] = cosine * at[0] + sine * at[1];
        turned[1] = cosine * at[1] - sine * at[0];
        found.velocity[0] = cosine * velocity[0] + sine * velocity[1];
        found.velocity[1] = cosine * velocity[1] - sine * velocity[0];
    }
    memcpy(found.inertial, found.velocity, sizeof found.inertial);
    if (spin != 0.0) {
        found.inertial[0] -= spin * turned[1];
        found.inertial[1] += spin * turned[0];
    }
    for (int i = 0; i < 3; i++)
        found.line[i] = turned[i] - sensor[i];
    found.distance = sqrt(dot(found.line, found.line));
    found.light_time = light_time;
    return found;
}

/* Residual of a bearing with its derivatives by the line of sight in the sensor's axes, and by the
   errors of azimuth and elevation. */
typedef struct {
    double value[2], by_sight[2][3], by_error[2][2];
} Miss;

#define ZENITH_ROUNDING 0.02
#define OPPOSITE 1e-7
#define LEAST_COSINE 1e-7

/* Cosine and sine of an angle less "by", from those of the angle. */
INLINE void turn_by(const double *angle, double by, double *cosine, double *sine)
{
    double c, s;
    if (fabs(by) < 0.05) {
        double square = by * by;
        c = 1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0)));
        s = by * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0)));
    } else {
        c = cos(by);
        s = sin(by);
    }
    *cosine = angle[0] * c + angle[1] * s;
    *sine = angle[1] * c - angle[0] * s;
}

/* factors/bearing.py: tangent_residual; "measured" has cosine and sine of azimuth and of elevation,
   from which the errors are taken. "noisy": the noise's metric is that of the measured elevation. */
INLINE Miss tangent_miss(const double *sight, const double *measured, const double *errors, int noisy)
{
    Miss found;
    double sin_a, cos_a, sin_e, cos_e;
    turn_by(measured, errors[AZIMUTH], &cos_a, &sin_a);
    turn_by(measured + 2, errors[ELEVATION], &cos_e, &sin_e);
    double near = 1.0 / sqrt(dot(sight, sight));
    double direction[3] = {sight[0] * near, sight[1] * near, sight[2] * near};
    double forward = direction[0] * cos_a + direction[1] * sin_a, up = direction[2];
    double s1 = direction[1] * cos_a - direction[0] * sin_a;
    double s2 = up * cos_e - forward * sin_e;
    double c = forward * cos_e + up * sin_e;
    double sine2 = s1 * s1 + s2 * s2;
    if (sine2 < OPPOSITE * OPPOSITE && c < 0.0) {
        s1 = OPPOSITE;
        s2 = 0.0;
        sine2 = s1 * s1 + s2 * s2;
    }
    double stretch = 1.0 + sine2 * (1.0 / 6.0 + sine2 * (3.0 / 40.0));
    double curvature = 1.0 / 3.0 + sine2 * (2.0 / 15.0);
    if (sine2 > 1e-6 || c < 0.0) {
        double sine = sqrt(sine2), theta = atan2(sine, c);
        stretch = theta / sine;
        curvature = (sine - theta * c) / (sine * sine * sine);
    }
    double ratio = 1.0, level2 = 1.0;
    if (noisy) {
        double noise = measured[2];
        level2 = cos_e * cos_e + ZENITH_ROUNDING * ZENITH_ROUNDING;
        ratio = sqrt((noise * noise + ZENITH_ROUNDING * ZENITH_ROUNDING) / level2);
    }
    found.value[0] = stretch * s1;
    found.value[1] = stretch * s2;
    double e1[3] = {-sin_a, cos_a, 0.0};
    double e2[3] = {-sin_e * cos_a, -sin_e * sin_a, cos_e};
    double u[3] = {cos_e * cos_a, cos_e * sin_a, sin_e};
    /* dr = stretch ds + curvature s (c s.ds - sin^2 dc). */
    for (int axis = 0; axis < 3; axis++) {
        double by = direction[axis];
        double ds1 = e1[axis] - s1 * by, ds2 = e2[axis] - s2 * by, dc = u[axis] - c * by;
        double both = curvature * (c * (s1 * ds1 + s2 * ds2) - sine2 * dc);
        found.by_sight[0][axis] = (stretch * ds1 + s1 * both) * near;
        found.by_sight[1][axis] = (stretch * ds2 + s2 * both) * near;
    }
    double turned[2][3] = {{sin_e * s2 - cos_e * c, -sin_e * s1, cos_e * s1}, {0.0, -c, s2}};
    for (int error = 0; error < 2; error++) {
        double ds1 = turned[error][0], ds2 = turned[error][1], dc = turned[error][2];
        double both = curvature * (c * (s1 * ds1 + s2 * ds2) - sine2 * dc);
        found.by_error[0][error] = -(stretch * ds1 + s1 * both);
        found.by_error[1][error] = -(stretch * ds2 + s2 * both);
    }
    if (noisy) {
        found.by_error[0][1] -= found.value[0] * cos_e * sin_e / level2;
        found.value[0] *= ratio;
        for (int axis = 0; axis < 3; axis++)
            found.by_sight[0][axis] *= ratio;
        found.by_error[0][0] *= ratio;
        found.by_error[0][1] *= ratio;
    }
    return found;
}

/* factors/bearing.py: coordinate_residual. */
INLINE Miss coordinate_miss(const double *sight, double azimuth, double elevation)
{
    Miss found;
    memset(&found, 0, sizeof found);
    double a = sight[0], b = sight[1], c = sight[2];
    double horizontal = hypot(a, b), distance2 = dot(sight, sight);
    double safe = fmax(horizontal, LEAST_COSINE * sqrt(distance2));
    double square = safe * safe, tilt = c / (safe * distance2);
    const double pi = 3.14159265358979323846;
    double gap = atan2(b, a) - azimuth + pi;
    found.value[0] = gap - 2.0 * pi * floor(gap / (2.0 * pi)) - pi;
    found.by_sight[0][0] = -b / square;
    found.by_sight[0][1] = a / square;
    found.by_error[0][0] = 1.0;
    if (!isnan(elevation)) {
        found.value[1] = atan2(c, horizontal) - elevation;
        found.by_sight[1][0] = -a * tilt;
        found.by_sight[1][1] = -b * tilt;
        found.by_sight[1][2] = horizontal / distance2;
        found.by_error[1][1] = 1.0;
    }
    return found;
}

/* Derivatives of the whitened rows by all channels of error and by the position at emission;
   families/bearings.py: _derivatives. */
INLINE void derive(const Bearings *all, Size i, Size pose, const double *errors, const Sight *seen,
                   const Miss *miss, double speed, double by_channel[2][CHANNELS],
                   double by_position[2][3])
{
    const double *axes = all->axes + 9 * pose;
    double unit[3], rate = speed;
    for (int j = 0; j < 3; j++)
        unit[j] = seen->line[j] / seen->distance;
    rate += dot(unit, seen->inertial);
    double sine = 0.0, cosine = 1.0;
    if (all->spin_rad_s != 0.0) {
        sine = sin(all->spin_rad_s * seen->light_time);
        cosine = cos(all->spin_rad_s * seen->light_time);
    }
    for (int q = 0; q < 2; q++) {
        double white = all->white[2 * i + q], in_axes[3], by[3];
        memset(by_channel[q], 0, sizeof by_channel[q]);
        for (int j = 0; j < 3; j++)
            in_axes[j] = miss->by_sight[q][j] * white;
        for (int j = 0; j < 3; j++)
            by[j] = in_axes[0] * axes[j] + in_axes[1] * axes[3 + j] + in_axes[2] * axes[6 + j];
        if (isfinite(all->speed_m_s)) {
            double along = dot(by, seen->inertial);
            if (all->fast)
                /* A faster signal was emitted later. */
                by_channel[q][SPEED] = along * seen->distance / (rate * speed);
            for (int j = 0; j < 3; j++)
                by[j] -= along * unit[j] / rate;
        }
        by_channel[q][AZIMUTH] = miss->by_error[q][0] * white;
        by_channel[q][ELEVATION] = miss->by_error[q][1] * white;
        for (int j = 0; j < 3; j++)
            by_channel[q][POSITION + j] = -by[j];
        if (all->clocked) {
            double by_time = 0.0;
            for (int j = 0; j < 3; j++)
                by_time += by[j] * (seen->velocity[j] - all->sensor_velocity[3 * pose + j] -
                                    errors[VELOCITY + j]);
            if (all->axes_rate != NULL)
                for (int j = 0; j < 3; j++)
                    by_time += in_axes[j] * dot(all->axes_rate + 9 * pose + 3 * j, seen->line);
            by_channel[q][CLOCK] = -by_time;
        }
        by_position[q][0] = cosine * by[0] - sine * by[1];
        by_position[q][1] = sine * by[0] + cosine * by[1];
        by_position[q][2] = by[2];
    }
}

/* "moving": velocities matter, for signals take their time or clocks are off. */
INLINE void bearings_of(Size order, int moving, const Bearings *all)
{
    Size size = 2 * order, guess = 0;
    for (Size i = 0; i < all->n; i++) {
        double errors[CHANNELS] = {0.0};
        Size pose = (Size)all->pose[i];
        for (Size k = all->first[i]; k < all->first[i + 1]; k++) {
            Size entry = all->entry[k];
            errors[all->constant_channel[entry]] +=
                all->constant_basis[entry] * all->constants[all->constant_column[entry]];
        }
        double speed = all->speed_m_s + errors[SPEED], sensor[3], place[2 * MOST_ORDER], rates[2 * MOST_ORDER];
        for (int j = 0; j < 3; j++)
            sensor[j] = all->sensor_m[3 * pose + j] + errors[POSITION + j];
        double light_time = all->light_time_s[i], emitted = 0.0;
        Sight seen;
        memset(&seen, 0, sizeof seen);
        for (int round = 0; round < all->rounds; round++) {
            emitted = all->received_s[i] - light_time;
            guess = find(all->knots_s, all->knots, emitted, guess);
            double before = all->knots_s[guess];
            weights(order, moving, all->hermite, all->knots_s[guess + 1] - before,
                    emitted - before, place, rates);
            const double *basis = all->basis + guess * size * 3;
            double at[3] = {0.0, 0.0, 0.0}, velocity[3] = {0.0, 0.0, 0.0};
            for (Size b = 0; b < size; b++)
                for (int j = 0; j < 3; j++) {
                    at[j] += place[b] * basis[3 * b + j];
                    if (moving)
                        velocity[j] += rates[b] * basis[3 * b + j];
                }
            seen = look(at, velocity, sensor, light_time, all->spin_rad_s);
            if (!moving || isinf(all->speed_m_s))
                break;
            double closing = dot(seen.line, seen.inertial) / seen.distance;
            double correction = (seen.distance - speed * light_time) / (speed + closing);
            if (!(fabs(correction) > all->enough_s)) {
                /* What is left is below a microsecond: straight motion meets it. */
                for (int j = 0; j < 3; j++)
                    at[j] -= velocity[j] * correction;
                seen = look(at, velocity, sensor, light_time + correction, all->spin_rad_s);
                break;
            }
            light_time = fmax(light_time + correction, 0.0);
        }
        /* Walks are of the directions alone, and are read in the interval of the emission; beyond it
           a walk is what it was at the nearer knot. */
        for (Size k = all->first_walk[i]; k < all->first_walk[i + 1]; k++) {
            Size entry = all->entry_walk[k];
            const double *chain = all->chains + guess * all->walks + all->walk_column[entry];
            double after = (all->walk_time[i] - all->knots_s[guess]) /
                           (all->knots_s[guess + 1] - all->knots_s[guess]);
            after = after < 0.0 ? 0.0 : after > 1.0 ? 1.0 : after;
            all->walk_before[entry] = 1.0 - after;
            all->walk_after[entry] = after;
            errors[all->walk_channel[entry]] +=
                ((1.0 - after) * chain[0] + after * chain[all->walks]) * all->walk_basis[entry];
        }
        all->light_time_s[i] = light_time;
        all->interval[i] = guess;
        all->time_s[i] = emitted;
        const double *axes = all->axes + 9 * pose;
        double sight[3] = {dot(axes, seen.line), dot(axes + 3, seen.line), dot(axes + 6, seen.line)};
        Miss miss;
        if (all->tangent == NULL || all->tangent[i] != 0.0)
            miss = tangent_miss(sight, all->turned + 4 * i, errors, all->noisy);
        else
            miss = coordinate_miss(sight, all->azimuth[i] - errors[AZIMUTH],
                                   all->elevation[i] - errors[ELEVATION]);
        for (int q = 0; q < 2; q++)
            all->residual[2 * i + q] = miss.value[q] * all->white[2 * i + q];
        if (all->by_position == NULL)
            continue;
        double channel[2][CHANNELS];
        derive(all, i, pose, errors, &seen, &miss, speed, channel, (double(*)[3])(all->by_position + 6 * i));
        memcpy(all->weights + i * size, place, sizeof(double) * (size_t)size);
        for (Size k = all->first[i]; k < all->first[i + 1]; k++) {
            Size entry = all->entry[k], by = (Size)all->constant_channel[entry];
            for (int q = 0; q < 2; q++)
                all->by_constants[2 * entry + q] = channel[q][by] * all->constant_basis[entry];
        }
        for (Size k = all->first_walk[i]; k < all->first_walk[i + 1]; k++) {
            Size entry = all->entry_walk[k], by = (Size)all->walk_channel[entry];
            for (int q = 0; q < 2; q++)
                all->by_walks[2 * entry + q] = channel[q][by] * all->walk_basis[entry];
        }
    }
}

WIDE static void bearings_all(const Bearings *all)
{
    int moving = isfinite(all->speed_m_s) || all->clocked;
    /* Loops of known length are unrolled for the usual motions. */
    if (all->order == 3)
        moving ? bearings_of(3, 1, all) : bearings_of(3, 0, all);
    else if (all->order == 2)
        moving ? bearings_of(2, 1, all) : bearings_of(2, 0, all);
    else
        bearings_of(all->order, 1, all);
}

static PyObject *bearings(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Bearings all;
    start(&reader, arguments, given);
    Size n = all.n = whole(&reader), knots = all.knots = whole(&reader);
    Size order = all.order = whole(&reader);
    Size e = all.e = whole(&reader);
    all.s = whole(&reader);
    Size f = all.f = whole(&reader);
    all.walks = whole(&reader);
    all.poses = whole(&reader);
    all.rounds = (int)whole(&reader);
    all.clocked = (int)whole(&reader);
    all.fast = (int)whole(&reader);
    all.noisy = (int)whole(&reader);
    all.speed_m_s = number(&reader);
    all.spin_rad_s = number(&reader);
    all.enough_s = number(&reader);
    if (!reader.failed && (order < 1 || order > MOST_ORDER || knots < 2)) {
        PyErr_SetString(PyExc_ValueError, "expected 1 to 3 blocks and two knots at least");
        reader.failed = 1;
    }
    all.knots_s = reals(&reader, knots);
    all.basis = reals(&reader, (knots - 1) * 2 * order * 3);
    all.hermite = reals(&reader, 4 * order * order);
    all.received_s = reals(&reader, n);
    all.pose = integers(&reader, n);
    all.sensor_m = reals(&reader, 3 * all.poses);
    all.axes = reals(&reader, 9 * all.poses);
    all.sensor_velocity = reals(&reader, 3 * all.poses);
    all.axes_rate = reals(&reader, 9 * all.poses);
    all.azimuth = reals(&reader, n);
    all.elevation = reals(&reader, n);
    all.turned = reals(&reader, 4 * n);
    all.tangent = reals(&reader, n);
    all.white = reals(&reader, 2 * n);
    all.light_time_s = results(&reader, n);
    all.residual = results(&reader, 2 * n);
    all.interval = whole_results(&reader, n);
    all.time_s = results(&reader, n);
    all.weights = results(&reader, n * 2 * order);
    all.by_position = results(&reader, n * 2 * 3);
    all.constant_row = integers(&reader, e);
    all.constant_channel = integers(&reader, e);
    all.constant_column = integers(&reader, e);
    all.constant_basis = reals(&reader, e);
    all.constants = reals(&reader, all.s);
    all.by_constants = results(&reader, all.by_position == NULL ? 0 : 2 * e);
    all.walk_row = integers(&reader, f);
    all.walk_channel = integers(&reader, f);
    all.walk_column = integers(&reader, f);
    all.walk_basis = reals(&reader, f);
    all.walk_time = reals(&reader, n);
    all.chains = reals(&reader, knots * all.walks);
    all.walk_before = results(&reader, f);
    all.walk_after = results(&reader, f);
    all.by_walks = results(&reader, all.by_position == NULL ? 0 : 2 * f);
    int there = all.knots_s && all.basis && all.hermite && all.received_s && all.pose && all.sensor_m &&
                all.axes && all.sensor_velocity && all.azimuth && all.elevation && all.turned &&
                all.white && all.light_time_s && all.residual && all.interval && all.time_s &&
                all.constant_row && all.constant_channel && all.constant_column &&
                all.constant_basis && all.constants && all.walk_row && all.walk_channel &&
                all.walk_column && all.walk_basis && all.walk_time && all.chains &&
                all.walk_before && all.walk_after;
    if (all.by_position != NULL)
        there = there && all.weights && all.by_constants && all.by_walks;
    if (!complete(&reader, there)) {
        release(&reader);
        return NULL;
    }
    int fits = 1;
    for (Size i = 0; i < n; i++)
        fits &= all.pose[i] >= 0 && all.pose[i] < all.poses;
    for (Size k = 0; k < e; k++)
        fits &= all.constant_channel[k] >= 0 && all.constant_channel[k] < CHANNELS &&
                all.constant_column[k] >= 0 && all.constant_column[k] < all.s;
    for (Size k = 0; k < f; k++)
        fits &= (all.walk_channel[k] == AZIMUTH || all.walk_channel[k] == ELEVATION) &&
                all.walk_column[k] >= 0 && all.walk_column[k] < all.walks;
    Size *index = malloc(sizeof(Size) * (size_t)(2 * (n + 2) + e + f));
    if (index == NULL) {
        release(&reader);
        return PyErr_NoMemory();
    }
    Py_BEGIN_ALLOW_THREADS
    Size *first_walk = index + n + 2, *entry = first_walk + n + 2, *entry_walk = entry + e;
    all.first = index;
    all.entry = entry;
    all.first_walk = first_walk;
    all.entry_walk = entry_walk;
    fits = fits && by_row(n, e, all.constant_row, index, entry) &&
           by_row(n, f, all.walk_row, first_walk, entry_walk);
    if (fits)
        bearings_all(&all);
    Py_END_ALLOW_THREADS
    free(index);
    release(&reader);
    if (!fits) {
        PyErr_SetString(PyExc_IndexError, "a row or channel is out of range");
        return NULL;
    }
    Py_RETURN_NONE;
}
