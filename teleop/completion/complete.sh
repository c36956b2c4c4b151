# What may stand where, in the words of POSIX sh: bash and zsh run it as it is, fish hands it to sh. No Python is started.

# _teleop_complete WORD BEFORE...: what WORD (the beginning of one) may become behind `teleop BEFORE...`; each on a line,
# a tab, and what it is. A line that begins with a tab asks the shell for its files: folders, or a pattern of names.
_teleop_complete() {
    _cur=$1; shift
    _pre= _cmd= _want= _many= _n=0 _scene= _law=
    for _w in "$@"; do
        case $_w in
            --?*=*) _teleop_option "$_cmd" "${_w%%=*}"; _teleop_note "$_want" "${_w#*=}"; _want= ;;
            -*) _teleop_option "$_cmd" "$_w" ;;
            *)
                if [ -n "$_want" ]; then
                    _teleop_note "$_want" "$_w"
                    [ -n "$_many" ] || _want=
                elif [ -z "$_cmd" ]; then
                    _cmd=$_w
                    _teleop_default "$_cmd"
                else
                    _n=$((_n + 1)); _teleop_place "$_cmd" "$_n"; _teleop_note "$_want" "$_w"; _want=
                fi ;;
        esac
    done
    case $_cur in
        --?*=*)
            _teleop_option "$_cmd" "${_cur%%=*}"
            _teleop_into "${_cur%%=*}="
            _teleop_kind "$_want" ;;
        -*) _teleop_data "options $_cmd" ;;
        *)
            if [ -n "$_want" ]; then
                _teleop_kind "$_want"
            elif [ -z "$_cmd" ]; then
                _teleop_data commands
            else
                _teleop_place "$_cmd" "$((_n + 1))"; _teleop_kind "$_want"
            fi ;;
    esac
}

# What was typed already says which scene and which law it is about.
_teleop_note() {
    case $1 in
        scene) _scene=$2 ;;
        law) _law=$2 ;;
        set | grid) case $2 in law=*) _law=${2#law=} ;; esac ;;
    esac
}

# The beginning $1 of the word stays; what follows it is completed.
_teleop_into() {
    _pre=$_pre$1
    _cur=${_cur#"$1"}
}

# The last one of words that commas join.
_teleop_last() {
    case $_cur in *,*) _teleop_into "${_cur%,*}," ;; esac
}

# What a value of one kind may be.
_teleop_kind() {
    case $1 in
        '') ;;
        scene | law) _teleop_data "$1"; printf '\tfiles\t*.py\n' ;;
        set | grid)
            case $_cur in
                *=*)
                    _knob=${_cur%%=*}
                    _teleop_into "$_knob="
                    [ "$1" = set ] || _teleop_last
                    if [ "$_knob" = law ]; then
                        _teleop_kind law
                    else
                        _teleop_data "value $_knob"
                    fi ;;
                *) _teleop_kind knob= ;;
            esac ;;
        knob | knob=)
            _end=${1#knob}
            _teleop_data "scene $_scene"
            [ -n "$_law" ] || _teleop_law "$_scene"
            _teleop_data "law ${_law%%(*}"
            _end= ;;
        laws | metrics | formats | playouts) _teleop_last; _teleop_data "$1"; [ "$1" != laws ] || printf '\tfiles\t*.py\n' ;;
        run)
            for _w in runs/*/; do
                _w=${_w%/}
                case $_w in "runs/*") ;; "$_cur"*) printf '%s\t\n' "$_pre$_w" ;; esac
            done
            case runs/ in "$_cur"*) [ -d runs ] || printf '\tfolders\n' ;; *) printf '\tfolders\n' ;; esac ;;
        folder) printf '\tfolders\n' ;;
        file) printf '\tfiles\t*\n' ;;
        *) _teleop_data "$1" ;;
    esac
}

# Says those of WORD MEANING WORD MEANING... that begin with what was typed.
_teleop_say() {
    while [ $# -gt 1 ]; do
        case $1 in "$_cur"*) printf '%s\t%s\n' "$_pre$1$_end" "$2" ;; esac
        shift 2
    done
}
_end=

