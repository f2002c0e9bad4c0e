/* The names that this adapter gives to the linker: each begins with the unit's own name, so that several units can be
 * parts of one program. FMU_PREFIX comes from the generated header fmu_model.h.
 */
#ifndef FMU_NAMES_H
#define FMU_NAMES_H

#include "fmu_model.h"

#define FMU_JOINED(a, b) a##b
#define FMU_PREFIXED(prefix, name) FMU_JOINED(prefix, name)
#define FMU_NAMED(name) FMU_PREFIXED(FMU_PREFIX, name)

#define fmu_the_unit FMU_NAMED(fmu_the_unit)
#define fmu_load_start_values FMU_NAMED(fmu_load_start_values)

#define fmu_create FMU_NAMED(fmu_create)
#define fmu_destroy FMU_NAMED(fmu_destroy)
#define fmu_set_start FMU_NAMED(fmu_set_start)
#define fmu_say FMU_NAMED(fmu_say)
#define fmu_initialize FMU_NAMED(fmu_initialize)
#define fmu_advance FMU_NAMED(fmu_advance)
#define fmu_find FMU_NAMED(fmu_find)
#define fmu_state_index FMU_NAMED(fmu_state_index)
#define fmu_observe FMU_NAMED(fmu_observe)
#define fmu_copy FMU_NAMED(fmu_copy)
#define fmu_set_inputs FMU_NAMED(fmu_set_inputs)
#define fmu_get FMU_NAMED(fmu_get)
#define fmu_set FMU_NAMED(fmu_set)
#define fmu_save FMU_NAMED(fmu_save)
#define fmu_restore FMU_NAMED(fmu_restore)
#define fmu_is_snapshot FMU_NAMED(fmu_is_snapshot)
#define fmu_free_snapshot FMU_NAMED(fmu_free_snapshot)
#define fmu_serialized_size FMU_NAMED(fmu_serialized_size)
#define fmu_serialize FMU_NAMED(fmu_serialize)
#define fmu_deserialize FMU_NAMED(fmu_deserialize)

/* Between these, what is declared stays inside the shared library that it is a part of. */
#if defined __GNUC__ && !defined _WIN32 && !defined __CYGWIN__
#define FMU_PRIVATE_BEGIN _Pragma("GCC visibility push(hidden)")
#define FMU_PRIVATE_END _Pragma("GCC visibility pop")
#else
#define FMU_PRIVATE_BEGIN
#define FMU_PRIVATE_END
#endif

#endif
