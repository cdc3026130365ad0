/* Arguments: counts, numbers and arrays through the buffer protocol, checked for their sizes. */

typedef struct {
    Py_buffer view;
    int held;
} Array;

#define MOST_ARRAYS 64
#define MOST_ORDER 3

typedef struct {
    PyObject *const *arguments;
    Size given, next;
    Array held[MOST_ARRAYS];
    int count;
    int failed;
} Reader;

static void start(Reader *reader, PyObject *const *arguments, Size given)
{
    reader->arguments = arguments;
    reader->given = given;
    reader->next = 0;
    reader->count = 0;
    reader->failed = 0;
}

static void release(Reader *reader)
{
    for (int i = 0; i < reader->count; i++)
        PyBuffer_Release(&reader->held[i].view);
    reader->count = 0;
}

static PyObject *following(Reader *reader)
{
    if (reader->failed)
        return NULL;
    if (reader->next >= reader->given) {
        PyErr_SetString(PyExc_TypeError, "too few arguments");
        reader->failed = 1;
        return NULL;
    }
    return reader->arguments[reader->next++];
}

static Size whole(Reader *reader)
{
    PyObject *object = following(reader);
    if (object == NULL)
        return 0;
    Size value = PyLong_AsSsize_t(object);
    if (value < 0) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_ValueError, "expected a count of at least 0");
        reader->failed = 1;
        return 0;
    }
    return value;
}

static double number(Reader *reader)
{
    PyObject *object = following(reader);
    if (object == NULL)
        return 0.0;
    double value = PyFloat_AsDouble(object);
    if (value == -1.0 && PyErr_Occurred())
        reader->failed = 1;
    return value;
}

/* Return an array's data; NULL for None, or with reader->failed set. */
static void *array(Reader *reader, Size count, const char *formats, int writable)
{
    Size place = reader->next;
    PyObject *object = following(reader);
    if (object == NULL || object == Py_None)
        return NULL;
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0);
    Array *own = &reader->held[reader->count];
    if (reader->count >= MOST_ARRAYS || PyObject_GetBuffer(object, &own->view, flags) < 0) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_TypeError, "too many arrays");
        reader->failed = 1;
        return NULL;
    }
    reader->count++;
    const char *format = own->view.format;
    int fits = format != NULL && strlen(format) == 1 && strchr(formats, format[0]) != NULL &&
               own->view.itemsize == 8 && own->view.len == 8 * count;
    if (!fits) {
        PyErr_Format(PyExc_ValueError,
                     "argument %zd holds %zd bytes of format %s; expected %zd of 8 bytes in %s",
                     place, own->view.len, format == NULL ? "none" : format, count, formats);
        reader->failed = 1;
        return NULL;
    }
    return own->view.buf;
}

static const double *reals(Reader *reader, Size count)
{
    return array(reader, count, "d", 0);
}

static double *results(Reader *reader, Size count)
{
    return array(reader, count, "d", 1);
}

static const int64_t *integers(Reader *reader, Size count)
{
    return array(reader, count, "lq", 0);
}

static int64_t *whole_results(Reader *reader, Size count)
{
    return array(reader, count, "lq", 1);
}

/* None was given where an array is needed. */
static int complete(Reader *reader, int all)
{
    if (!reader->failed && reader->next != reader->given) {
        PyErr_SetString(PyExc_TypeError, "too many arguments");
        reader->failed = 1;
    }
    if (!reader->failed && !all) {
        PyErr_SetString(PyExc_TypeError, "an array is missing");
        reader->failed = 1;
    }
    return !reader->failed;
}
