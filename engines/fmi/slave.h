/* A co-simulation slave around one engine, free of FMI versions; fmi2.c and fmi3.c translate.
 *
 * Every function that returns bool has, when it returns false, logged one line and put the slave into FAILED, from
 * where only reset, a restored state or free lead on, as both FMI versions ask for.
 */
#ifndef SLAVE_H
#define SLAVE_H

#include <stdbool.h>

#include "engine.h"

typedef enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    STEPPING = 4,
    TERMINATED = 8,
    FAILED = 16
} Mode;

enum { ANY_MODE = INSTANTIATED | INITIALIZATION | STEPPING | TERMINATED | FAILED };

typedef enum { REAL, INTEGER } Type;

typedef struct Slave Slave;
typedef struct Snapshot Snapshot;
typedef void (*Log)(void *environment, const char *message);

/* `resources`: where the archive's are, as the importer says it; NULL, after a log line, where there can be no slave. */
ENGINE_LOCAL Slave *slave_new(Log log, void *environment, bool logging, const char *resources);
ENGINE_LOCAL void slave_free(Slave *s);
ENGINE_LOCAL void *slave_environment(const Slave *s);
ENGINE_LOCAL void slave_set_logging(Slave *s, bool logging);
ENGINE_LOCAL bool slave_fail(Slave *s, const char *format, ...);

/* True in one of `modes`; else fails, naming `function`. */
ENGINE_LOCAL bool slave_allows(Slave *s, const char *function, unsigned modes);

/* The four transitions; the caller has asked slave_allows() before. */
ENGINE_LOCAL bool slave_set_experiment(Slave *s, double start, bool stop_defined, double stop);
ENGINE_LOCAL void slave_enter_initialization(Slave *s);
ENGINE_LOCAL bool slave_exit_initialization(Slave *s);
ENGINE_LOCAL void slave_terminate(Slave *s);
ENGINE_LOCAL void slave_reset(Slave *s);

ENGINE_LOCAL bool slave_get(Slave *s, uint32_t reference, Type type, double *value);
ENGINE_LOCAL bool slave_set(Slave *s, uint32_t reference, Type type, double value);

/* Step from `point` by `step` [s]: `point` must be where the slave stands, `step` a whole number of ENGINE_STEP. */
ENGINE_LOCAL bool slave_do_step(Slave *s, double point, double step);
ENGINE_LOCAL double slave_time(const Slave *s);

/* Saved states, freed with free().  Where *snapshot is null, it is allocated. */
ENGINE_LOCAL bool slave_save(Slave *s, Snapshot **snapshot);
ENGINE_LOCAL bool slave_restore(Slave *s, const Snapshot *snapshot);
ENGINE_LOCAL size_t slave_serialized_size(void);
ENGINE_LOCAL bool slave_serialize(Slave *s, const Snapshot *snapshot, unsigned char *bytes, size_t size);
ENGINE_LOCAL bool slave_deserialize(Slave *s, const unsigned char *bytes, size_t size, Snapshot **snapshot);

#endif
