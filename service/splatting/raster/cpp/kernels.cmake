# The rasterizer: sources, and how its kernels are compiled: once per instruction set, each into a namespace of its own,
# and chosen at run time. Never -ffast-math: it folds away rounding tricks and NaN checks.
set(RASTER ${CMAKE_CURRENT_LIST_DIR})
set(RASTER_KERNELS
    accumulate_weights adam bench_kernels cross_entropy image_loss kernel_table label_map label_sums projection_backward
    projection_forward rasterize_backward rasterize_forward share_map
    spherical_harmonics surface_loss tile_ranges)
set(RASTER_HOST dispatch isects render_context render_labels thread_pool)
set(RASTER_BINDINGS bind_bench bind_losses bind_parameters bind_render module)
foreach(part KERNELS HOST BINDINGS)
  list(TRANSFORM RASTER_${part} REPLACE "(.+)" "${RASTER}/\\1.cpp")
endforeach()
set(RASTER_FLAGS -O3 -fno-math-errno -fno-trapping-math -fvisibility=hidden -Wall -Wno-psabi -Wno-maybe-uninitialized -Wno-uninitialized)
# A loop over a block's Gaussians must stay one loop: of two, each would walk the block mask again.
set_source_files_properties(
  ${RASTER}/rasterize_forward.cpp ${RASTER}/label_map.cpp ${RASTER}/label_sums.cpp ${RASTER}/share_map.cpp
  PROPERTIES COMPILE_OPTIONS -fno-tree-loop-distribution)

function(_add_kernels target name)
  add_library(kernels_${name} OBJECT ${RASTER_KERNELS})
  set_target_properties(kernels_${name} PROPERTIES POSITION_INDEPENDENT_CODE ON)
  target_compile_options(kernels_${name} PRIVATE ${RASTER_FLAGS} ${ARGN})
  target_sources(${target} PRIVATE $<TARGET_OBJECTS:kernels_${name}>)
endfunction()

# Into a target that has RASTER_HOST: those that the processor may be able to run. Elsewhere than on x86, GCC's vectors
# of 16 bytes are the machine's own, as of NEON.
function(add_raster_kernels target)
  _add_kernels(${target} baseline)
  if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64|amd64")
    target_compile_definitions(${target} PRIVATE FS_X86)
    _add_kernels(${target} avx2 -DFS_AVX2 -mavx2 -mfma -mbmi -mbmi2)
    _add_kernels(${target} avx512 -DFS_AVX512 -mavx512f -mavx512dq -mavx512vl -mavx512bw -mfma -mbmi -mbmi2 -mprefer-vector-width=512)
  endif()
endfunction()
