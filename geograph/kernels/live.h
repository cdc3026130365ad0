/* The newest end of a chain, as measurements arrive: what geograph/incremental does with few rows
   and few knots, a call for a step of it in place of dozens of small arrays. */

/* Return an array of booleans; NULL for None, or with reader->failed set. */
static const char *flags(Reader *reader, Size count)
{
    Size place = reader->next;
    PyObject *object = following(reader);
    if (object == NULL || object == Py_None)
        return NULL;
    Array *own = &reader->held[reader->count];
    if (reader->count >= MOST_ARRAYS ||
        PyObject_GetBuffer(object, &own->view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_TypeError, "too many arrays");
        reader->failed = 1;
        return NULL;
    }
    reader->count++;
    if (own->view.format == NULL || strcmp(own->view.format, "?") != 0 || own->view.len != count) {
        PyErr_Format(PyExc_ValueError, "argument %zd holds %zd bytes; expected %zd booleans", place,
                     own->view.len, count);
        reader->failed = 1;
        return NULL;
    }
    return own->view.buf;
}

/* incremental/rows.py: _check, of bearings; false where it would find something. */
static PyObject *sound_bearings(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size n = whole(&reader), sensors = whole(&reader);
    const double *time = reals(&reader, n);
    const int64_t *sensor = integers(&reader, n);
    const double *azimuth = reals(&reader, n), *elevation = reals(&reader, n);
    const double *first = reals(&reader, n), *second = reals(&reader, n);
    int sound = 1;
    if (!complete(&reader, time && sensor && azimuth && elevation && first && second)) {
        release(&reader);
        return NULL;
    }
    for (Size i = 0; i < n; i++)
        sound &= isfinite(time[i]) && sensor[i] >= 0 && sensor[i] < sensors &&
                 isfinite(azimuth[i]) && !isinf(elevation[i]) && isfinite(first[i]) &&
                 first[i] > 0.0 && !isinf(second[i]) && !(second[i] <= 0.0);
    release(&reader);
    return PyBool_FromLong(sound);
}

/* incremental/room.py: emission_times, where no clock walks; from places of the sensors, or of each
   row's where they move. */
static PyObject *departures(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size n = whole(&reader), m = whole(&reader), sensors = whole(&reader), s = whole(&reader);
    double newest_s = number(&reader), speed = number(&reader);
    const double *tag_s = reals(&reader, n);
    const int64_t *sensor = integers(&reader, n);
    const double *position = reals(&reader, 3 * sensors);
    const int64_t *bias = integers(&reader, sensors * CHANNELS);
    const int64_t *drift = integers(&reader, sensors * CHANNELS);
    const double *since_s = reals(&reader, sensors * CHANNELS), *sigma = reals(&reader, s);
    const double *constants = reals(&reader, s), *state = reals(&reader, m);
    const double *places = reals(&reader, 3 * n);
    double *emitted = results(&reader, n), *delay = results(&reader, n);
    int fits = 1;
    if (!complete(&reader, tag_s && sensor && position && bias && drift && since_s && sigma &&
                               constants && state && emitted && delay && m >= 3)) {
        release(&reader);
        return NULL;
    }
    for (Size i = 0; i < n; i++) {
        if (sensor[i] < 0 || sensor[i] >= sensors) {
            fits = 0;
            break;
        }
        Size place = (Size)sensor[i] * CHANNELS + CLOCK;
        double received = tag_s[i], away[3];
        if (bias[place] >= s || drift[place] >= s) {
            fits = 0;
            break;
        }
        if (bias[place] >= 0)
            received -= constants[bias[place]] * sigma[bias[place]];
        if (drift[place] >= 0)
            received -= constants[drift[place]] * sigma[drift[place]] * (tag_s[i] - since_s[place]);
        for (int j = 0; j < 3; j++) {
            away[j] = state[j] - (places ? places[3 * i + j] : position[3 * sensor[i] + j]);
            if (m > 3)
                away[j] += (received - newest_s) * state[3 + j];
        }
        emitted[i] = isfinite(speed) ? received - sqrt(dot(away, away)) / speed : received;
        delay[i] = received - emitted[i];
    }
    release(&reader);
    if (!fits) {
        PyErr_SetString(PyExc_IndexError, "a sensor or column is out of range");
        return NULL;
    }
    Py_RETURN_NONE;
}

/* One interval of a chain, with the rows of bearings in it. */
typedef struct {
    Size n, order, sensors, s, walks;
    int clocked, level_noise, rounds, loss;
    double speed_m_s, spin_rad_s, enough_s, zenith, tuning, low_s, high_s, knots_s[2];
    const double *time_s, *azimuth, *elevation, *sigma_azimuth, *sigma_elevation, *delay_s;
    const int64_t *sensor;
    const char *isotropic, *kept;
    const double *position, *axes, *since_s, *sigma, *walk_scale, *diffusion;
    const double *row_position, *row_velocity, *row_axes, *row_axes_rate; /* where sensors move */
    const int64_t *bias, *drift, *walk;
    const double *hermite, *unit_root, *density, *scale;
    const double *path[2], *reference_path[2], *chains[2], *reference_chains[2];
    const double *constants, *reference;
    double *block, *inverse, *root, *noise, *at_path, *at_chains, *emitted_s, *residual;
} LiveInterval;

/* Work of an interval: everything in one piece of memory. */
typedef struct {
    double *velocity, *white, *tangent, *turned, *received, *delay, *weights;
    double *by_position, *weight, *basis, *by_constants, *walk_basis, *walk_time, *before, *after;
    double *by_walks, *chains, *pair, *others, *ahead;
    int64_t *interval, *pose, *row, *channel, *column, *walk_row, *walk_channel, *walk_column;
    Size *index;
} LiveRoom;

static double *carve(double **free, Size count)
{
    double *own = *free;
    *free += count;
    return own;
}

/* Make room for an interval; NULL without memory. All that is held has eight bytes. */
static double *live_room(const LiveInterval *own, Size e, Size f, LiveRoom *room)
{
    Size n = own->n, d = 3 * own->order + own->walks, c = own->s + 1, order = own->order;
    Size touched = c + 2 * own->walks, sensors = own->sensors;
    Size reals = 3 * sensors + n * (2 + 1 + 4 + 1 + 1 + 2 * order + 6 + 1 + 1 + 1 + 1) + 3 * e +
                 5 * f + 2 * own->walks + 6 * order + c * c + 2 * d + c;
    Size entries = 3 * (e + f) + 2 * (n + 2) + e + f + 2 * touched;
    double *all = calloc((size_t)(reals + entries + 8), 8), *free = all;
    if (all == NULL)
        return NULL;
    room->velocity = carve(&free, 3 * sensors);
    room->white = carve(&free, 2 * n);
    room->tangent = carve(&free, n);
    room->turned = carve(&free, 4 * n);
    room->received = carve(&free, n);
    room->delay = carve(&free, n);
    room->weights = carve(&free, 2 * order * n);
    room->by_position = carve(&free, 6 * n);
    room->weight = carve(&free, n);
    room->walk_time = carve(&free, n);
    room->interval = (int64_t *)carve(&free, n);
    room->pose = (int64_t *)carve(&free, n);
    room->basis = carve(&free, e);
    room->by_constants = carve(&free, 2 * e);
    room->walk_basis = carve(&free, f);
    room->before = carve(&free, f);
    room->after = carve(&free, f);
    room->by_walks = carve(&free, 2 * f);
    room->chains = carve(&free, 2 * own->walks);
    room->pair = carve(&free, 6 * order);
    room->others = carve(&free, c * c);
    room->ahead = carve(&free, 2 * d + c);
    room->row = (int64_t *)carve(&free, e);
    room->channel = (int64_t *)carve(&free, e);
    room->column = (int64_t *)carve(&free, e);
    room->walk_row = (int64_t *)carve(&free, f);
    room->walk_channel = (int64_t *)carve(&free, f);
    room->walk_column = (int64_t *)carve(&free, f);
    room->index = (Size *)free;
    return all;
}

/* Count the entries of the derivatives by constants and walks; 0 if an index is out of range. */
static int count_entries(const LiveInterval *own, Size *e, Size *f)
{
    *e = *f = 0;
    for (Size i = 0; i < own->n; i++) {
        if (own->sensor[i] < 0 || own->sensor[i] >= own->sensors)
            return 0;
        Size first = (Size)own->sensor[i] * CHANNELS;
        for (Size channel = first; channel < first + CHANNELS; channel++) {
            if (own->bias[channel] >= own->s || own->drift[channel] >= own->s ||
                own->walk[channel] >= own->walks)
                return 0;
            *e += (own->bias[channel] >= 0) + (own->drift[channel] >= 0);
            *f += own->walk[channel] >= 0;
        }
    }
    return 1;
}

/* losses.py: the weight of a squared residual. */
enum { NO_LOSS = 0, HUBER = 1, CAUCHY = 2, GEMAN_MCCLURE = 3 };

static double weight_of(int loss, double tuning, double square)
{
    double scale = tuning * tuning;
    if (loss == HUBER)
        return square > scale ? tuning / sqrt(square) : 1.0;
    if (loss == CAUCHY)
        return 1.0 / (1.0 + square / scale);
    if (loss == GEMAN_MCCLURE) {
        double share = scale / (scale + square);
        return share * share;
    }
    return 1.0;
}

/* What families/bearings.py and states.py make of rows when a family is built: poses of sensors that
   stand still, reciprocals of sigmas, and which row feels which state. Walks are of directions. */
static void lay_out_rows(const LiveInterval *own, LiveRoom *room, Bearings *all)
{
    int uniform = 1;
    Size e = 0, f = 0;
    for (Size i = 0; i < own->n; i++) {
        Size sensor = (Size)own->sensor[i], first = sensor * CHANNELS;
        int lone = isnan(own->elevation[i]), tangent = own->isotropic[i] && !lone;
        double level = lone ? 0.0 : own->elevation[i], received = 0.0;
        room->pose[i] = own->row_position == NULL ? (int64_t)sensor : (int64_t)i;
        room->turned[4 * i] = cos(own->azimuth[i]);
        room->turned[4 * i + 1] = sin(own->azimuth[i]);
        room->turned[4 * i + 2] = cos(level);
        room->turned[4 * i + 3] = sin(level);
        room->tangent[i] = tangent;
        uniform &= tangent;
        room->white[2 * i] = 1.0 / own->sigma_azimuth[i];
        room->white[2 * i + 1] = lone ? 0.0 : 1.0 / own->sigma_elevation[i];
        if (!tangent && !lone && room->turned[4 * i + 2] < own->zenith)
            /* At the zenith a coordinate's azimuth says nothing, however small its sigma. */
            room->white[2 * i] = 0.0;
        room->weight[i] = own->kept[i] ? 1.0 : 0.0;
        for (int drift = 0; drift < 2; drift++)
            for (Size channel = 0; channel < CHANNELS; channel++) {
                int64_t column = (drift ? own->drift : own->bias)[first + channel];
                if (column < 0)
                    continue;
                double basis = drift ? own->time_s[i] - own->since_s[first + channel] : 1.0;
                room->row[e] = (int64_t)i;
                room->channel[e] = (int64_t)channel;
                room->column[e] = column;
                room->basis[e] = basis * own->sigma[column];
                if (channel == CLOCK)
                    received += room->basis[e] * own->constants[column];
                e++;
            }
        for (Size channel = 0; channel < CHANNELS; channel++) {
            int64_t column = own->walk[first + channel];
            if (column < 0)
                continue;
            room->walk_row[f] = (int64_t)i;
            room->walk_channel[f] = (int64_t)channel;
            room->walk_column[f] = column;
            room->walk_basis[f++] = own->walk_scale[column];
        }
        room->received[i] = own->time_s[i] - received;
        room->delay[i] = own->delay_s[i];
        room->walk_time[i] = own->time_s[i];
    }
    all->e = e;
    all->f = f;
    all->tangent = uniform ? NULL : room->tangent;
}

/* Evaluate the rows of an interval, and add them up in "block". */
static int evaluate_rows(const LiveInterval *own, LiveRoom *room)
{
    Size order = own->order, m = 3 * order, d = m + own->walks, c = own->s + 1;
    Bearings all;
    memset(&all, 0, sizeof all);
    all.n = own->n;
    all.knots = 2;
    all.order = order;
    all.s = own->s;
    all.walks = own->walks;
    lay_out_rows(own, room, &all);
    memcpy(room->pair, own->path[0], sizeof(double) * (size_t)m);
    memcpy(room->pair + m, own->path[1], sizeof(double) * (size_t)m);
    memcpy(room->chains, own->chains[0], sizeof(double) * (size_t)own->walks);
    memcpy(room->chains + own->walks, own->chains[1], sizeof(double) * (size_t)own->walks);
    all.knots_s = own->knots_s;
    all.basis = room->pair;
    all.hermite = own->hermite;
    all.received_s = room->received;
    int moving = own->row_position != NULL;
    all.pose = room->pose;
    all.poses = moving ? own->n : own->sensors;
    all.sensor_m = moving ? own->row_position : own->position;
    all.axes = moving ? own->row_axes : own->axes;
    all.sensor_velocity = moving ? own->row_velocity : room->velocity;
    all.axes_rate = own->row_axes_rate;
    all.azimuth = own->azimuth;
    all.elevation = own->elevation;
    all.turned = room->turned;
    all.noisy = own->level_noise;
    all.white = room->white;
    all.speed_m_s = own->speed_m_s;
    all.spin_rad_s = own->spin_rad_s;
    all.enough_s = own->enough_s;
    all.clocked = own->clocked;
    all.rounds = own->rounds;
    all.light_time_s = room->delay;
    all.residual = own->residual;
    all.interval = room->interval;
    all.time_s = own->emitted_s;
    all.weights = room->weights;
    all.by_position = room->by_position;
    all.constant_row = room->row;
    all.constant_channel = room->channel;
    all.constant_column = room->column;
    all.constant_basis = room->basis;
    all.constants = own->constants;
    all.by_constants = room->by_constants;
    all.walk_row = room->walk_row;
    all.walk_channel = room->walk_channel;
    all.walk_column = room->walk_column;
    all.walk_basis = room->walk_basis;
    all.walk_time = room->walk_time;
    all.chains = room->chains;
    all.walk_before = room->before;
    all.walk_after = room->after;
    all.by_walks = room->by_walks;
    Size *first = room->index, *first_walk = first + own->n + 2;
    Size *entry = first_walk + own->n + 2, *entry_walk = entry + all.e;
    all.first = first;
    all.entry = entry;
    all.first_walk = first_walk;
    all.entry_walk = entry_walk;
    if (!by_row(own->n, all.e, room->row, first, entry) ||
        !by_row(own->n, all.f, room->walk_row, first_walk, entry_walk))
        return 0;
    bearings_all(&all);
    if (own->walks) {
        /* Walks are read at the emission, as it was found before. */
        memcpy(room->walk_time, own->emitted_s, sizeof(double) * (size_t)own->n);
        bearings_all(&all);
    }
    int all_count = 1;
    for (Size i = 0; i < own->n; i++) {
        const double *miss = own->residual + 2 * i;
        if (own->loss != NO_LOSS && room->weight[i] > 0.0)
            room->weight[i] = sqrt(
                weight_of(own->loss, own->tuning, miss[0] * miss[0] + miss[1] * miss[1]));
        all_count &= room->weight[i] == 1.0;
    }
    Blocks sums;
    memset(&sums, 0, sizeof sums);
    sums.n = own->n;
    sums.r = 2;
    sums.intervals = sums.held = 1;
    sums.path = m;
    sums.walks = own->walks;
    sums.constants = own->s;
    sums.order = order;
    sums.e = all.e;
    sums.f = all.f;
    sums.chained = 1;
    sums.knots = own->block;
    sums.others = room->others;
    sums.residual = own->residual;
    sums.by_path = room->by_position;
    sums.weights = room->weights;
    sums.scale = own->scale;
    sums.by_constants = room->by_constants;
    sums.before = room->before;
    sums.after = room->after;
    sums.by_walks = room->by_walks;
    sums.weight = all_count ? NULL : room->weight;
    sums.interval = room->interval;
    sums.constant_row = room->row;
    sums.constant_column = room->column;
    sums.walk_row = room->walk_row;
    sums.walk_column = room->walk_column;
    sums.first = first;
    sums.entry = entry;
    sums.first_walk = first_walk;
    sums.entry_walk = entry_walk;
    Held held;
    held.from = entry_walk + all.f;
    held.at = held.from + c + 2 * own->walks;
    double *own_room = make_room(&sums, 2 * d, &held);
    held.touched = calloc((size_t)(c + 2 * own->walks), 1);
    int good = own_room != NULL && held.touched != NULL && add_all(&sums, &held);
    free(own_room);
    free(held.touched);
    return good;
}

/* Fill in the rest of a whole block, and write it about the chain's reference: 0 if it is not
   finite. */
WIDE static int refer(const LiveInterval *own, LiveRoom *room)
{
    Size m = 3 * own->order, d = m + own->walks, c = own->s + 1, width = 2 * d + c;
    double *block = own->block, *ahead = room->ahead, total = 0.0;
    for (Size i = 0; i < c; i++) {
        double *row = block + (2 * d + i) * width;
        for (Size j = 0; j < 2 * d; j++)
            row[j] = block[j * width + 2 * d + i];
        memcpy(row + 2 * d, room->others + i * c, sizeof(double) * (size_t)c);
    }
    for (Size i = 0; i < width * width; i++)
        total += block[i];
    if (!isfinite(total))
        return 0;
    int moved = 0;
    for (Size half = 0; half < 2; half++) {
        for (Size j = 0; j < m; j++)
            ahead[half * d + j] = (own->path[half][j] - own->reference_path[half][j]) / own->scale[j];
        for (Size j = 0; j < own->walks; j++)
            ahead[half * d + m + j] = own->chains[half][j] - own->reference_chains[half][j];
    }
    for (Size j = 0; j < own->s; j++)
        ahead[2 * d + j] = own->constants[j] - own->reference[j];
    for (Size j = 0; j < width - 1; j++)
        moved |= ahead[j] != 0.0;
    for (Size i = 0; moved && i < width - 1; i++) {
        double by = 0.0;
        for (Size j = 0; j < width - 1; j++)
            by += block[i * width + j] * ahead[j];
        block[i * width + width - 1] -= by;
    }
    for (Size i = 0; moved && i < width - 1; i++)
        block[(width - 1) * width + i] = block[i * width + width - 1];
    return 1;
}

/* incremental/model.py: _transitions, of motions whose transitions are the same everywhere. */
static void follow(const LiveInterval *own)
{
    Size m = 3 * own->order, d = m + own->walks;
    double step = own->knots_s[1] - own->knots_s[0];
    double pair[6 * MOST_ORDER], by[9 * MOST_ORDER * MOST_ORDER] = {0.0};
    double root[9 * MOST_ORDER * MOST_ORDER] = {0.0};
    memcpy(pair, own->reference_path[0], sizeof(double) * (size_t)m);
    memcpy(pair + m, own->reference_path[1], sizeof(double) * (size_t)m);
    kinematics_all(1, own->order, own->unit_root, own->density, own->scale, &step, pair, by, root,
                   own->noise);
    memset(own->inverse, 0, sizeof(double) * (size_t)(d * d));
    memset(own->root, 0, sizeof(double) * (size_t)(d * d));
    for (Size i = 0; i < m; i++) {
        memcpy(own->inverse + i * d, by + i * m, sizeof(double) * (size_t)m);
        memcpy(own->root + i * d, root + i * m, sizeof(double) * (size_t)m);
    }
    for (Size j = 0; j < own->walks; j++) {
        Size at = (m + j) * d + m + j;
        own->inverse[at] = 1.0;
        own->root[at] = own->diffusion[j] * sqrt(step) / own->walk_scale[j];
        own->noise[m + j] =
            (own->reference_chains[1][j] - own->reference_chains[0][j]) / own->root[at];
    }
}

/* 1: done; 0: rows are elsewhere; -1: not finite; -2: no memory; -3: out of range. */
static int linearise_interval(const LiveInterval *own)
{
    Size m = 3 * own->order, d = m + own->walks, width = 2 * d + own->s + 1, e, f;
    if (!count_entries(own, &e, &f))
        return -3;
    LiveRoom room;
    double *memory = live_room(own, e, f, &room);
    if (memory == NULL)
        return -2;
    int found = 1;
    memset(own->block, 0, sizeof(double) * (size_t)(width * width));
    if (!evaluate_rows(own, &room))
        found = -2;
    for (Size i = 0; found == 1 && i < own->n; i++)
        if (own->emitted_s[i] < own->low_s || own->emitted_s[i] > own->high_s)
            found = 0;
    if (found == 1 && !refer(own, &room))
        found = -1;
    if (found == 1) {
        follow(own);
        for (Size half = 0; half < 2; half++) {
            memcpy(own->at_path + half * m, own->path[half], sizeof(double) * (size_t)m);
            memcpy(own->at_chains + half * own->walks, own->chains[half],
                   sizeof(double) * (size_t)own->walks);
        }
    }
    free(memory);
    return found;
}

static PyObject *live_interval(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    LiveInterval all;
    start(&reader, arguments, given);
    Size n = all.n = whole(&reader), order = all.order = whole(&reader);
    Size sensors = all.sensors = whole(&reader), s = all.s = whole(&reader);
    Size walks = all.walks = whole(&reader);
    all.clocked = (int)whole(&reader);
    all.level_noise = (int)whole(&reader);
    all.rounds = (int)whole(&reader);
    all.loss = (int)whole(&reader);
    all.speed_m_s = number(&reader);
    all.spin_rad_s = number(&reader);
    all.enough_s = number(&reader);
    all.zenith = number(&reader);
    all.tuning = number(&reader);
    all.hermite = reals(&reader, 4 * order * order);
    all.unit_root = reals(&reader, order * order);
    all.scale = reals(&reader, 3 * order);
    all.position = reals(&reader, 3 * sensors);
    all.axes = reals(&reader, 9 * sensors);
    all.bias = integers(&reader, sensors * CHANNELS);
    all.drift = integers(&reader, sensors * CHANNELS);
    all.since_s = reals(&reader, sensors * CHANNELS);
    all.sigma = reals(&reader, s);
    all.walk = integers(&reader, sensors * CHANNELS);
    all.walk_scale = reals(&reader, walks);
    all.diffusion = reals(&reader, walks);
    all.density = reals(&reader, 3);
    all.low_s = number(&reader);
    all.high_s = number(&reader);
    all.knots_s[0] = number(&reader);
    all.knots_s[1] = number(&reader);
    all.time_s = reals(&reader, n);
    all.sensor = integers(&reader, n);
    all.azimuth = reals(&reader, n);
    all.elevation = reals(&reader, n);
    all.sigma_azimuth = reals(&reader, n);
    all.sigma_elevation = reals(&reader, n);
    all.isotropic = flags(&reader, n);
    all.kept = flags(&reader, n);
    all.delay_s = reals(&reader, n);
    all.row_position = reals(&reader, 3 * n);
    all.row_velocity = reals(&reader, 3 * n);
    all.row_axes = reals(&reader, 9 * n);
    all.row_axes_rate = reals(&reader, 9 * n);
    Size m = 3 * order, d = m + walks, width = 2 * d + s + 1;
    for (int half = 0; half < 2; half++) {
        all.path[half] = reals(&reader, m);
        all.reference_path[half] = reals(&reader, m);
        all.chains[half] = reals(&reader, walks);
        all.reference_chains[half] = reals(&reader, walks);
    }
    all.constants = reals(&reader, s);
    all.reference = reals(&reader, s);
    all.block = results(&reader, width * width);
    all.inverse = results(&reader, d * d);
    all.root = results(&reader, d * d);
    all.noise = results(&reader, d);
    all.at_path = results(&reader, 2 * m);
    all.at_chains = results(&reader, 2 * walks);
    all.emitted_s = results(&reader, n);
    all.residual = results(&reader, 2 * n);
    int there = all.hermite && all.unit_root && all.scale && all.position && all.axes && all.bias &&
                all.drift && all.since_s && all.sigma && all.walk && all.walk_scale &&
                all.diffusion && all.density && all.time_s && all.sensor && all.azimuth &&
                all.elevation && all.sigma_azimuth && all.sigma_elevation && all.isotropic &&
                all.kept && all.delay_s && all.path[0] && all.path[1] && all.reference_path[0] &&
                all.reference_path[1] && all.chains[0] && all.chains[1] && all.reference_chains[0] &&
                all.reference_chains[1] && all.constants && all.reference && all.block &&
                all.inverse && all.root && all.noise && all.at_path && all.at_chains &&
                all.emitted_s && all.residual &&
                !all.row_position == !all.row_velocity && !all.row_position == !all.row_axes &&
                order >= 1 && order <= MOST_ORDER;
    if (!complete(&reader, there)) {
        release(&reader);
        return NULL;
    }
    int found;
    Py_BEGIN_ALLOW_THREADS
    found = linearise_interval(&all);
    Py_END_ALLOW_THREADS
    release(&reader);
    if (found == -2)
        return PyErr_NoMemory();
    if (found == -3) {
        PyErr_SetString(PyExc_IndexError, "a sensor or column is out of range");
        return NULL;
    }
    return PyLong_FromLong(found);
}

/* incremental/chain.py: one interval of a sweep, which adds to what is known of the constants. */
static PyObject *live_eliminate(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Sweep all;
    memset(&all, 0, sizeof all);
    start(&reader, arguments, given);
    Size d = all.d = whole(&reader), c = all.c = whole(&reader), w = d + c, width = w + d;
    double sums[2] = {0.0, 0.0};
    all.n = 1;
    all.sums = sums;
    all.knot = reals(&reader, d * w);
    const double *known = reals(&reader, c * c), *block = reals(&reader, width * width);
    all.blocks = block;
    all.inverse_transition = reals(&reader, d * d);
    all.noise_root = reals(&reader, d * d);
    all.noise_residual = reals(&reader, d);
    all.knots = results(&reader, d * w);
    all.shares = results(&reader, c * c);
    all.back = results(&reader, d * w);
    all.spread = results(&reader, d * d);
    if (!complete(&reader, all.knot && known && block && all.inverse_transition && all.noise_root &&
                               all.noise_residual && all.knots && all.shares && all.back &&
                               all.spread && c > 0)) {
        release(&reader);
        return NULL;
    }
    Size working = room_for(d, c) + d * PADDED(w) + 1;
    double *work = malloc(sizeof(double) * (size_t)(working + c * c));
    if (work == NULL) {
        release(&reader);
        return PyErr_NoMemory();
    }
    int good;
    Py_BEGIN_ALLOW_THREADS
    double *others = work + working;
    for (Size i = 0; i < c; i++)
        for (Size j = 0; j < c; j++)
            others[i * c + j] = known[i * c + j] + block[(2 * d + i) * width + 2 * d + j];
    all.others = others;
    good = sweep_all(&all, work);
    Py_END_ALLOW_THREADS
    free(work);
    release(&reader);
    return PyBool_FromLong(good);
}

/* incremental/chain.py: _finish. The lower factor of the information of the newest knot and the
   constants, its upper triangle zero, and the step that it gives. */
#define LEAST_PIVOT 1e-300 /* so that the covariance is finite */

WIDE static int finish_all(Size d, Size c, const double *knot, const double *other,
                           const double *hold, double *root, double *step)
{
    Size w = d + c, n = w - 1;
    for (Size i = 0; i < d; i++) {
        memcpy(root + i * n, knot + i * w, sizeof(double) * (size_t)(i + 1));
        step[i] = -knot[i * w + w - 1];
    }
    for (Size i = 0; i < c - 1; i++) {
        double *row = root + (d + i) * n;
        for (Size j = 0; j < d; j++)
            row[j] = knot[j * w + d + i];
        for (Size j = 0; j <= i; j++)
            row[d + j] = other[i * c + j] + hold[i * c + j];
        step[d + i] = -(other[i * c + c - 1] + hold[i * c + c - 1]);
    }
    for (Size i = 0; i < n; i++) {
        double *row = root + i * n;
        memset(row + i + 1, 0, sizeof(double) * (size_t)(n - i - 1));
        for (Size j = 0; j <= i; j++) {
            const double *column = root + j * n;
            double value = row[j];
            for (Size k = 0; k < j; k++)
                value -= row[k] * column[k];
            if (j < i)
                row[j] = value / column[j];
            else if (value > LEAST_PIVOT && isfinite(value))
                row[j] = sqrt(value);
            else
                return 0;
        }
    }
    for (Size i = 0; i < n; i++) {
        for (Size k = 0; k < i; k++)
            step[i] -= root[i * n + k] * step[k];
        step[i] /= root[i * n + i];
    }
    for (Size i = n - 1; i >= 0; i--) {
        step[i] /= root[i * n + i];
        for (Size k = 0; k < i; k++)
            step[k] -= root[i * n + k] * step[i];
    }
    for (Size i = 0; i < n; i++)
        if (!isfinite(step[i]))
            return 0;
    return 1;
}

static PyObject *live_finish(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size d = whole(&reader), c = whole(&reader), w = d + c;
    const double *knot = reals(&reader, d * w), *other = reals(&reader, c * c);
    const double *hold = reals(&reader, c * c);
    double *root = results(&reader, (w - 1) * (w - 1)), *step = results(&reader, w - 1);
    if (!complete(&reader, knot && other && hold && root && step && c > 0)) {
        release(&reader);
        return NULL;
    }
    int good;
    Py_BEGIN_ALLOW_THREADS
    good = finish_all(d, c, knot, other, hold, root, step);
    Py_END_ALLOW_THREADS
    release(&reader);
    return PyBool_FromLong(good);
}

/* The inverse of R R', R a lower factor. */
WIDE static void spread_all(Size n, const double *root, double *work, double *covariance)
{
    memset(work, 0, sizeof(double) * (size_t)(n * n));
    memset(covariance, 0, sizeof(double) * (size_t)(n * n));
    for (Size i = 0; i < n; i++) {
        /* Row i of the inverse factor, from those before. */
        double *row = work + i * n, by = 1.0 / root[i * n + i];
        for (Size k = 0; k < i; k++) {
            double share = -root[i * n + k] * by;
            const double *before = work + k * n;
            for (Size j = 0; j <= k; j++)
                row[j] += share * before[j];
        }
        row[i] = by;
        for (Size a = 0; a <= i; a++) {
            double share = row[a];
            double *restrict out = covariance + a * n;
            for (Size b = 0; b <= a; b++)
                out[b] += share * row[b];
        }
    }
    mirror(n, covariance);
}

static PyObject *live_covariance(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size n = whole(&reader);
    const double *root = reals(&reader, n * n);
    double *covariance = results(&reader, n * n);
    if (!complete(&reader, root && covariance)) {
        release(&reader);
        return NULL;
    }
    double *work = malloc(sizeof(double) * (size_t)(n * n + 1));
    if (work == NULL) {
        release(&reader);
        return PyErr_NoMemory();
    }
    Py_BEGIN_ALLOW_THREADS
    spread_all(n, root, work, covariance);
    Py_END_ALLOW_THREADS
    free(work);
    release(&reader);
    Py_RETURN_NONE;
}

/* incremental/chain.py: solve, of one knot. Its offset from the one after it, or as it is given
   where "back" is None, and its estimate. */
static PyObject *live_place(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size d = whole(&reader), c = whole(&reader), m = whole(&reader);
    const double *back = reals(&reader, d * (d + c)), *step = reals(&reader, d + c - 1);
    const double *next = reals(&reader, d), *scale = reals(&reader, d);
    const double *reference_path = reals(&reader, m), *reference_chains = reals(&reader, d - m);
    double *offset = results(&reader, d), *path = results(&reader, m);
    double *chains = results(&reader, d - m);
    if (!complete(&reader, step && (next || !back) && scale && reference_path && reference_chains &&
                               offset && path && chains && c > 0 && m <= d)) {
        release(&reader);
        return NULL;
    }
    for (Size i = 0; i < d; i++) {
        double value = step[i];
        if (back != NULL) {
            const double *row = back + i * (d + c);
            value = row[d + c - 1];
            for (Size j = 0; j < d; j++)
                value += row[j] * next[j];
            for (Size j = d; j < d + c - 1; j++)
                value += row[j] * step[j];
        }
        offset[i] = value;
        if (i < m)
            path[i] = reference_path[i] + value * scale[i];
        else
            chains[i - m] = reference_chains[i - m] + value;
    }
    release(&reader);
    Py_RETURN_NONE;
}

/* incremental/curvature.py: Limits.moved, of one interval. */
static PyObject *live_moved(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size blocks = whole(&reader), m = whole(&reader), walks = whole(&reader), s = whole(&reader);
    const double *scale = reals(&reader, m + walks), *most_path = reals(&reader, blocks);
    const double *most_chains = reals(&reader, walks), *most_constants = reals(&reader, s);
    const double *path[2], *chains[2];
    path[0] = reals(&reader, m);
    path[1] = reals(&reader, m);
    const double *at_path = reals(&reader, 2 * m);
    chains[0] = reals(&reader, walks);
    chains[1] = reals(&reader, walks);
    const double *at_chains = reals(&reader, 2 * walks);
    const double *constants = reals(&reader, s), *at_constants = reals(&reader, s);
    if (!complete(&reader, scale && most_path && most_chains && most_constants && path[0] &&
                               path[1] && at_path && chains[0] && chains[1] && at_chains &&
                               constants && at_constants && 3 * blocks <= m)) {
        release(&reader);
        return NULL;
    }
    int far = 0;
    for (Size half = 0; half < 2; half++) {
        for (Size block = 0; block < blocks; block++) {
            double square = 0.0;
            for (Size j = 3 * block; j < 3 * block + 3; j++) {
                double gap = (path[half][j] - at_path[half * m + j]) / scale[j];
                square += gap * gap;
            }
            far |= sqrt(square) > most_path[block];
        }
        for (Size j = 0; j < walks; j++)
            far |= fabs(chains[half][j] - at_chains[half * walks + j]) > most_chains[j];
    }
    for (Size j = 0; j < s; j++)
        far |= fabs(constants[j] - at_constants[j]) > most_constants[j];
    release(&reader);
    return PyBool_FromLong(far);
}
