"""LLVM code of kernels: functions that only kernels call stay intermediate code, optimised once with the whole."""

from typing import Any

import llvmlite.binding as llvm
from numba.core import config
from numba.core.cgutils import normalize_ir_text
from numba.core.codegen import CodeLibrary, JITCodeLibrary, JITCPUCodegen

from lfmesh.kernels.private.expected import require, require_call
from lfmesh.kernels.private.tables import promise_unchanged


class IntermediateLibrary(CodeLibrary):  # type: ignore[misc]
    """Code of a function that only kernels call, neither optimised nor translated to machine code."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.modules: list[bytes] = []
        """LLVM modules, as bitcode."""
        self.linked: dict[CodeLibrary, None] = {}
        """Libraries that its code calls, in order."""

    def add_ir_module(self, ir_module: Any) -> None:
        """Add a module of intermediate code, with linkage that lets LLVM drop unused functions."""
        prefer_wide_registers(ir_module)
        module = llvm.parse_assembly(normalize_ir_text(str(ir_module)))
        module.verify()
        for function in module.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"
        self.modules.append(module.as_bitcode())

    def add_linking_library(self, library: CodeLibrary) -> None:
        """Note a library that the function calls."""
        self.linked[library] = None

    def finalize(self) -> None:
        """Do nothing: the code is finished in the kernels that link it."""

    def get_function(self, name: str) -> Any:
        """Return a function by name."""
        return self._get_module_for_linking().get_function(name)

    def get_llvm_str(self) -> str:
        """Return the code as text."""
        return str(self._get_module_for_linking())

    def get_asm_str(self) -> str:
        """Return the machine code as text."""
        raise NotImplementedError(f"{self.name} is compiled in its callers only")

    def _get_module_for_linking(self) -> Any:
        """Return a copy of the code for a caller (numba's name)."""
        first, *others = map(llvm.parse_bitcode, self.modules)
        for other in others:
            first.link_in(other)
        return first


class KernelLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Machine code of a kernel that Python calls, with all functions that it calls linked in."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.linked: dict[CodeLibrary, None] = {}
        """Libraries that its code calls, callers first."""

    def add_ir_module(self, ir_module: Any) -> None:
        """Add a module."""
        prefer_wide_registers(ir_module)
        super().add_ir_module(ir_module)

    def add_linking_library(self, library: CodeLibrary) -> None:
        """Note a library that the kernel calls, and the libraries called by it."""
        if library not in self.linked:
            self.linked[library] = None
            for called in library.linked if isinstance(library, IntermediateLibrary) else ():
                self.add_linking_library(called)

    def _optimize_functions(self, ll_module: Any) -> None:
        """Skip the optimisation of single functions (numba's name), as the whole is optimised."""
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        """Link all libraries and optimise the result once (numba's name).

        Numba alone optimises twice, the first time to merge reference counts, which kernels do not have.
        """
        for library in self.linked:
            self._reload_init.update(library._reload_init)
            # Intermediate code is parsed anew for every kernel, so linking may consume it.
            preserve = not isinstance(library, IntermediateLibrary)
            self._final_module.link_in(library._get_module_for_linking(), preserve=preserve)
        passes, settings = self._codegen._module_pass_manager()
        passes.run(self._final_module, settings)


def prefer_wide_registers(ir_module: Any) -> None:
    """Let LLVM use 512-bit registers if the processor has them; its default is 256 bits on many processors.

    The blocks of the sequential engine then run a third faster. NUMBA_CPU_FEATURES, if set, takes precedence.
    """
    if config.CPU_FEATURES is None:
        for function in ir_module.functions:
            if not function.is_declaration:
                # `set.add`, as llvmlite's own `add` rejects attributes with a value.
                set.add(function.attributes, '"prefer-vector-width"="512"')
    for function in ir_module.functions:
        promise_unchanged(function)


def probe() -> None:
    """Raise AttributeError if numba's libraries lack, or no longer call, the methods overridden here."""
    names = ("_optimize_functions", "_optimize_final_module", "_get_module_for_linking", "enable_object_caching")
    require(JITCodeLibrary, "add_ir_module", "add_linking_library", *names)
    require(JITCPUCodegen, "_module_pass_manager")
    # Without this call, code is neither linked nor optimised, and LLVM ends the process.
    require_call(JITCodeLibrary.finalize, "_optimize_final_module")
    require_call(JITCodeLibrary.add_llvm_module, "_optimize_functions")
    if IntermediateLibrary.__abstractmethods__:
        raise AttributeError(f"CodeLibrary demands {', '.join(sorted(IntermediateLibrary.__abstractmethods__))}")
