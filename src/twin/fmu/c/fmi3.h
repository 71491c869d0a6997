/* FMI 3.0 as far as the FMUs of this project have it: types, and macros that make functions. */

#ifndef FMI3_H
#define FMI3_H

#include <stdbool.h>

#include "fmi.h"

typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8, fmi3Byte;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean, fmi3Clock;
typedef const char *fmi3String;
typedef const fmi3Byte *fmi3Binary;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent,
    fmi3Constant,
    fmi3Fixed,
    fmi3Tunable,
    fmi3Discrete,
    fmi3Dependent
} fmi3DependencyKind;
typedef enum {
    fmi3IntervalNotYetKnown,
    fmi3IntervalUnchanged,
    fmi3IntervalChanged
} fmi3IntervalQualifier;

typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment, fmi3Float64, fmi3Boolean,
                                               fmi3Boolean, fmi3Boolean, fmi3Boolean,
                                               fmi3Boolean *, fmi3Float64 *);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);

/* Whether an instance is made with the token of this very FMU; logs a line if not. */
int fmi3_is_own_token(fmi3String token, fmi3String own, fmi3InstanceEnvironment host,
                      fmi3LogMessageCallback log);

/* What each kind of FMU defines for the macros below; they log why they fail. */
fmi3Status fmi3_refuse(fmi3Instance instance, const char *what); /* `what`: the operation that is not supported */
fmi3Status fmi3_get(fmi3Instance instance, int type, fmi3ValueReference variable, double *value);
fmi3Status fmi3_set(fmi3Instance instance, int type, fmi3ValueReference variable, double value);

#define GET_AND_SET(Name, type, kind)                                                              \
    EXPORT fmi3Status fmi3Get##Name(fmi3Instance instance, const fmi3ValueReference vr[],          \
                                    size_t n, type value[], size_t m) {                            \
        if (n != m)                                                                                \
            return fmi3_refuse(instance, "an array");                                              \
        for (size_t i = 0; i < n; i++) {                                                           \
            double found;                                                                          \
            if (fmi3_get(instance, kind, vr[i], &found) != fmi3OK)                                 \
                return fmi3Error;                                                                  \
            value[i] = (type)found;                                                                \
        }                                                                                          \
        return fmi3OK;                                                                             \
    }                                                                                              \
    EXPORT fmi3Status fmi3Set##Name(fmi3Instance instance, const fmi3ValueReference vr[],          \
                                    size_t n, const type value[], size_t m) {                      \
        if (n != m)                                                                                \
            return fmi3_refuse(instance, "an array");                                              \
        for (size_t i = 0; i < n; i++)                                                             \
            if (fmi3_set(instance, kind, vr[i], (double)value[i]) != fmi3OK)                       \
                return fmi3Error;                                                                  \
        return fmi3OK;                                                                             \
    }

/* Functions that take an instance and what there is none of: nothing of it is done without error. */
#define WITHOUT(Name, what, ...)                                                                   \
    EXPORT fmi3Status fmi3##Name(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,   \
                                 __VA_ARGS__) {                                                    \
        (void)vr;                                                                                  \
        return n ? fmi3_refuse(instance, what) : fmi3OK;                                           \
    }

/* Functions that are refused whatever they are called with. */
#define REFUSED(Name, what, ...)                                                                   \
    EXPORT fmi3Status fmi3##Name(__VA_ARGS__) { return fmi3_refuse(instance, what); }

#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#endif
