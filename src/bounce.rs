//! Light after several reflections: gather at the surfels, update their radiosity, again. PBGI §8.3.
